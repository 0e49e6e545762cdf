//! Versions of CDR as DDS negotiates them: a writer offers one, a reader accepts both.

use ledger_gate::sample::{Sample, XCDR2};
use rtps::qos::{Qos as Policies, Representation};

/// The policies of a reader: it accepts both versions of CDR.
pub(crate) fn accepting(policies: Policies) -> Policies {
    Policies { representations: vec![Representation::XCDR1, Representation::XCDR2], ..policies }
}

/// The policies of a writer of this version.
pub(super) fn offering(policies: Policies, version: Representation) -> Policies {
    Policies { representations: vec![version], ..policies }
}

/// The version of a sample; none for an encoding that is unknown.
pub(super) fn version_of(sample: &Sample) -> Option<Representation> {
    match sample.representation_id() {
        [0, 0..=3] => Some(Representation::XCDR1),
        id if XCDR2.contains(&id) => Some(Representation::XCDR2),
        _ => None,
    }
}
