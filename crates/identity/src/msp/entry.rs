//! The checks of authorities when they enter. Those that are in already are checked by each certificate that they issued.

use super::{Msp, path};
use crate::certificate::Usage;
use crate::identity::{IdentityError, printable};
use crate::signature::{WANTED_KEY, check_key};

impl Msp {
    /// Checks that people could sign in by each authority, at a time in microseconds since the UNIX epoch. Its key verifies,
    /// nothing critical in it is unknown, it has not ended, and it leads to a root. Those that `before` has are not checked.
    ///
    /// # Errors
    /// [`IdentityError::UnusableAuthority`], [`IdentityError::Expired`], and what is wrong with the path of an intermediate.
    pub fn check_entry(&self, before: Option<&Self>, at: u64) -> Result<(), IdentityError> {
        self.check_spelling(before.unwrap_or(self))?;
        let is_new =
            |der: &[u8]| before.is_none_or(|before| before.authorities().all(|known| known.der.as_ref() != der));
        for authority in self.authorities().filter(|authority| is_new(&authority.der)) {
            let certificate = &authority.certificate;
            let unusable = |found: String, wanted| IdentityError::UnusableAuthority {
                subject: printable(&certificate.subject),
                found,
                wanted,
            };
            check_key(&certificate.public_key_info).map_err(|found| unusable(found, WANTED_KEY))?;
            if let Some(oid) = certificate.unknown_critical() {
                let found = format!("the critical extension {oid}, which is not known here");
                return Err(unusable(
                    found,
                    "no critical extension but those of RFC 5280 for names, uses and policies",
                ));
            }
            if !certificate.allows(Usage::Client) {
                let found = "an extended key usage without clientAuth".to_owned();
                return Err(unusable(found, "clientAuth, or no extended key usage"));
            }
            if certificate.not_after < at {
                let (subject, not_after) = (printable(&certificate.subject), certificate.not_after);
                return Err(IdentityError::Expired { subject, not_after, at });
            }
        }
        self.intermediates
            .iter()
            .filter(|intermediate| is_new(&intermediate.der))
            .try_for_each(|intermediate| path::check_leads_to_root(self, intermediate))
    }

    /// Checks that each authority writes its name in one way, here and in an earlier state of the organisation. The ledger names
    /// the issuer of a certificate by the bytes of its name. With other bytes, revoked certificates would count again.
    ///
    /// # Errors
    /// [`IdentityError::UnusableAuthority`].
    pub fn check_spelling(&self, before: &Self) -> Result<(), IdentityError> {
        let names = || self.authorities().map(|authority| &authority.certificate.subject_name);
        let known = || names().chain(before.authorities().map(|authority| &authority.certificate.subject_name));
        let odd = names().find(|name| known().any(|other| other == *name && other.der() != name.der()));
        odd.map_or(Ok(()), |name| {
            Err(IdentityError::UnusableAuthority {
                subject: printable(&name.to_string()),
                found: "its name in another spelling than in another certificate of it".into(),
                wanted: "one spelling (string types, case and white space), because revocations name it by its bytes",
            })
        })
    }
}
