//! When the certificate of another branch contradicts a chain.

use crate::scenes::{Scene, change, members};
use crate::world::{NOW, World};
use ledger_base::rejection::Code;
use ledger_light::{Certificate, Change, Governance};

fn rule(height: u64, json: &str) -> Change {
    change(height, vec![("certificates".into(), Some(json.to_owned().into()))])
}

/// Voters 1 of Org1 and 3 of Org2, whose certificates are strict from block 2 on.
struct Common {
    scene: Scene,
    governance: Governance,
}

impl Common {
    fn new() -> Self {
        let scene = Scene::new(World::new(), &[1, 3]);
        let founded = Governance::founded(scene.network, NOW, &scene.genesis).unwrap();
        let later = rule(9, r#"{"cleared":true}"#);
        let governance = founded.as_of(4, &[rule(2, r#"{"strict_since":2}"#), later]).unwrap();
        assert_eq!(governance.height(), 4);
        Self { scene, governance }
    }

    fn certificate(&self, nodes: &[u64]) -> Certificate {
        self.scene.proof(&self.scene.block(8, &[]), nodes).certificate
    }

    fn refused(&self, changes: &[Change], nodes: &[u64]) -> Option<Code> {
        self.governance.check_branch(changes, &self.certificate(nodes)).err().map(|refused| refused.code)
    }
}

#[test]
fn a_certificate_counts_against_a_chain_only_if_it_is_strict() {
    let common = Common::new();
    assert_eq!(common.refused(&[], &[1, 3]), None);
    assert_eq!(common.refused(&[], &[1]), Some(Code::Untrusted));
    let plain = Governance::founded(common.scene.network, NOW, &common.scene.genesis).unwrap();
    let refused = plain.check_strict(&common.certificate(&[1, 3])).unwrap_err();
    assert!(refused.code == Code::Untrusted && refused.message.contains("not strict"), "{refused}");
}

#[test]
fn it_must_be_strict_by_the_common_voters_and_by_all_since() {
    let common = Common::new();
    let all = change(5, vec![members(&[1, 2, 3, 4], &[])]);
    assert_eq!(common.refused(std::slice::from_ref(&all), &[1, 3]), Some(Code::Untrusted), "by the common voters only");
    assert_eq!(common.refused(std::slice::from_ref(&all), &[1, 2, 3, 4]), None);
    // The branch makes others the voters, and comes back: those in between count, too.
    let back = change(6, vec![members(&[1, 3], &[])]);
    assert_eq!(common.refused(&[all, back], &[1, 3]), Some(Code::Untrusted));
    let liars = change(5, vec![members(&[1, 2], &[])]);
    assert_eq!(common.refused(&[liars], &[1, 2]), Some(Code::Untrusted), "by the voters since only");
    let cleared = rule(5, r#"{"cleared":true}"#);
    assert_eq!(common.refused(&[cleared], &[1, 3]), Some(Code::Untrusted), "the branch has ended the rule");
    let own = change(8, vec![members(&[1, 2, 3, 4], &[])]);
    assert_eq!(common.refused(&[own], &[1, 3]), None, "the voters of the certified block are those before it");
}
