//! Whether a sample can be a message of its route's type, where the type's definition is built in.

use ledger_base::rejection::{Code, Rejection};
use ros_message::{Library, Message};

use crate::graph::names::TypeName;
use ledger_gate::sample::{Sample, XCDR2};

/// The type with which samples of a route are compared.
pub(crate) struct LengthCheck(Option<Message>);

impl LengthCheck {
    /// The definition of a type; without one every sample fits.
    pub(crate) fn of(message: &TypeName) -> Self {
        Self(Library::builtin().message(&message.to_string()).ok())
    }

    /// Every sample fits.
    pub(crate) fn none() -> Self {
        Self(None)
    }

    /// Checks lengths only: what the numbers mean is for the robot. Bytes may follow a message, as for every listener of ROS 2.
    ///
    /// # Errors
    /// [`Code::BadMessage`] if there are too few bytes for the type.
    pub(crate) fn check(&self, sample: &Sample) -> Result<(), Rejection> {
        // Lengths of XCDR2 are others.
        let Some(message) = self.0.as_ref().filter(|_| !XCDR2.contains(&sample.representation_id())) else {
            return Ok(());
        };
        message.check(sample.wire()).map_err(|fault| {
            Rejection::new(Code::BadMessage, fault.message)
                .found(fault.found)
                .wanted(fault.wanted)
                .next("the publisher in this graph has another definition of the type: build it against the robot's")
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use ledger_gate::sample::CDR_LE;

    fn check(name: &str, body: &[u8]) -> Result<(), Rejection> {
        LengthCheck::of(&TypeName::parse(name).unwrap()).check(&Sample::new(CDR_LE, body).unwrap())
    }

    #[test]
    fn a_sample_whose_length_cannot_be_the_types_does_not_fit() {
        assert!(check("geometry_msgs/msg/Twist", &[0; 48]).is_ok());
        for length in [0, 24, 47] {
            let refused = check("geometry_msgs/msg/Twist", &vec![0; length]).unwrap_err();
            assert_eq!(refused.code, Code::BadMessage, "{length}");
            assert!(refused.message.contains("geometry_msgs/msg/Twist"), "{refused:?}");
        }
        assert!(check("std_msgs/msg/String", &[9, 0, 0, 0, b'a', 0, 0, 0]).is_err());
    }

    #[test]
    fn bytes_behind_a_message_pass() {
        for length in [49, 52, 96] {
            assert!(check("geometry_msgs/msg/Twist", &vec![1; length]).is_ok(), "{length}");
        }
        assert!(check("std_msgs/msg/String", &[2, 0, 0, 0, b'a', 0]).is_ok());
        assert!(check("std_msgs/msg/String", &[2, 0, 0, 0, b'a', 0, b'x', b'y', b'z']).is_ok());
    }

    #[test]
    fn a_type_without_a_definition_admits_everything() {
        assert!(check("arm_msgs/msg/Grip", &[1, 2, 3]).is_ok());
    }

    #[test]
    fn a_sample_in_xcdr2_is_not_measured_by_the_lengths_of_plain_cdr() {
        let fit = LengthCheck::of(&TypeName::parse("geometry_msgs/msg/Twist").unwrap());
        assert!(fit.check(&Sample::new([0, 9], &[0; 52]).unwrap()).is_ok());
    }
}
