//! A CA in an admin's hands: a copy for the safe, the way back from it, and its end at one node when it moves to another.
//!
//! A copy leaves the node under a passphrase of the admin's, and the ledger knows before the admin has it. That is no power
//! that admins lack: they may let a node of their own carry the CA, which the ledger knows, too.

use super::authorities::lock;
use super::{EnrolmentService, Shared, given_up_file, json};
use crate::trust::ca;
use crate::trust::ca::CertificateAuthority;
use crate::trust::ca::backup;
use crate::trust::ca::backup::Backup;
use ledger::msp::UncarryCa;
use ledger_api::v1;
use ledger_base::durable::{SECRET_MODE, rename, replace};
use ledger_base::rejection::{Code, Rejection};
use ledger_identity::Identity;
use std::path::PathBuf;
use std::sync::Arc;

/// In front of the name of a CA's directory that is about to be removed.
const DROPPED: &str = ".dropped-";

impl EnrolmentService {
    /// The CA of the caller's organisation as a file under a passphrase. The ledger is told first.
    pub(super) async fn copy(
        &self,
        admin: Arc<Identity>,
        request: v1::CopyCaRequest,
    ) -> Result<v1::CopyCaResponse, Rejection> {
        let organisation = request.organisation.clone();
        self.shared.check_own(&admin, &organisation)?;
        let file = self
            .blocking(move |shared| {
                let authority = shared.authority(&request.organisation)?;
                let authority = lock(&authority);
                backup::text(&authority, &request.passphrase)
            })
            .await?;
        let authority = self.shared.authority(&organisation)?;
        let proof = lock(&authority).prove(&self.shared.ledger.network(), &self.shared.own.me.full_name());
        let told = ledger::msp::CarryCa { copied_by: Some(admin.id()), ..proof };
        (self.shared.client.submit)("carry_ca", json(&told)?).await?;
        tracing::warn!(by = admin.id(), organisation, "CA key backed up under a passphrase");
        Ok(v1::CopyCaResponse { verdict: Some(v1::Verdict::default()), file: file.into() })
    }

    /// Puts a copy of the CA of the caller's organisation back at this node, which carries it from now on.
    pub(super) async fn restore(&self, admin: &Identity, request: v1::RestoreCaRequest) -> Result<(), Rejection> {
        let organisation = request.organisation.clone();
        self.shared.check_own(admin, &organisation)?;
        if self.carries(&organisation) {
            return Err(Rejection::new(Code::AlreadyExists, "this node holds this CA key already")
                .found(self.shared.own.me.full_name())
                .wanted("a node that does not hold it"));
        }
        self.blocking(move |shared| shared.restore(&request)).await?;
        tracing::warn!(
            by = admin.id(),
            organisation,
            "CA key restored from a backup; this node issues certificates \
                                                       from now on"
        );
        self.tell_carried(&organisation).await
    }

    /// This node carries the CA of the caller's organisation no more: its key is removed from the disk.
    pub(super) async fn give_up(&self, admin: &Identity, organisation: &str) -> Result<(), Rejection> {
        self.shared.check_own(admin, organisation)?;
        let me = self.shared.own.me.full_name();
        if !self.shared.carriers(organisation).iter().any(|(carrier, _)| carrier.full_name() != me) {
            return Err(Rejection::new(
                Code::LastOne,
                format!("{me} is the last node that holds the CA key of {organisation}"),
            )
            .wanted("another node that holds it, according to the ledger")
            .next("ledgerctl ca carry NODE"));
        }
        let owner = organisation.to_owned();
        self.blocking(move |shared| shared.remove(&owner)).await?;
        tracing::warn!(by = admin.id(), organisation, "CA key removed from this node");
        let uncarry = UncarryCa { organisation: organisation.to_owned(), node: None };
        (self.shared.client.submit)("uncarry_ca", json(&uncarry)?).await?;
        self.shared.authorities.settle_given_up(organisation);
        Ok(())
    }
}

impl Shared {
    fn restore(&self, request: &v1::RestoreCaRequest) -> Result<(), Rejection> {
        let v1::RestoreCaRequest { organisation, file, passphrase } = request;
        if self.own.me.organisation != *organisation {
            return Err(Rejection::new(
                Code::WrongRole,
                format!("this node may not hold the CA key of {organisation}"),
            )
            .found(format!("node {}", self.own.me.full_name()))
            .wanted(format!("a node of {organisation}")));
        }
        let Backup { organisation: found, key, root } = backup::parse("the backup", file, passphrase)?;
        let msps = self.ledger.msps();
        if found != *organisation || !msps.get(organisation).is_some_and(|msp| msp.roots().any(|known| *known == *root))
        {
            return Err(Rejection::new(Code::BadFile, "the backup is of another CA")
                .found(format!("the CA of {}", super::printable(&found)))
                .wanted(format!("a CA of {organisation} that the ledger lists")));
        }
        let directory = self.authorities.directory(organisation);
        ledger_base::durable::create_directory(directory.parent().unwrap_or(&directory))?;
        self.authorities.add(CertificateAuthority::install(&directory, organisation, &key, &root)?);
        self.authorities.settle_given_up(organisation);
        Ok(())
    }

    /// Removes the CA's directory. A crash in between leaves a node that says that it carries the CA no more.
    fn remove(&self, organisation: &str) -> Result<(), Rejection> {
        let authority = self.authority(organisation)?;
        let _quiet = lock(&authority);
        let directory = self.authorities.directory(organisation);
        let dropped = self.dropped(organisation);
        replace(&given_up_file(self.authorities.data(), organisation), b"", SECRET_MODE)?;
        ca::remove(&dropped)?;
        rename(&directory, &dropped)?;
        self.authorities.forget(organisation);
        ca::remove(&dropped)
    }

    /// Removes the key that a crash has left of a CA that was given up.
    pub(super) fn remove_dropped(&self, organisation: &str) -> Result<(), Rejection> {
        ca::remove(&self.dropped(organisation))
    }

    /// The place of a CA's directory that is about to be removed.
    fn dropped(&self, organisation: &str) -> PathBuf {
        self.authorities.directory(organisation).with_file_name(format!("{DROPPED}{organisation}"))
    }
}
