//! The identity of a robot has the robot's exact name.

use crate::output::Output;
use crate::session::{ABAC, Session};
use ledger_base::rejection::{Code, Rejection};
use ledger_contract::RobotAsset;
use ledger_identity::Role;

/// Rejects a name that differs from that of a robot of the own organisation only in the case of its letters. Notes it if no robot of
/// this name is registered.
///
/// # Errors
/// [`Code::AlreadyExists`] with the name of the robot.
pub(super) async fn check_name(session: &Session, name: &str, role: Role, output: &Output) -> Result<(), Rejection> {
    let home = session.identity()?.organisation;
    let robots: Vec<RobotAsset> = session.list(ABAC, "robots").await?;
    let names: Vec<String> =
        robots.into_iter().filter(|robot| robot.organisation == home).map(|robot| robot.name).collect();
    check(name, &names)?;
    if role == Role::Robot && !names.iter().any(|robot| robot == name) {
        output.note(&format!("{home} has no robot {name} yet: the identity of a robot must have exactly its name"));
    }
    Ok(())
}

fn check(name: &str, robots: &[String]) -> Result<(), Rejection> {
    match robots.iter().find(|robot| robot.eq_ignore_ascii_case(name) && *robot != name) {
        None => Ok(()),
        Some(robot) => Err(Rejection::new(
            Code::AlreadyExists,
            format!("{name} differs from the name of a robot only in upper and lower case"),
        )
        .found(format!("robot {robot}"))
        .wanted(format!("{robot} for the identity of this robot, or another name"))
        .next(format!("for the robot: ledgerctl identity register {robot} --role robot"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_differs_from_a_robots_only_in_case_is_rejected_with_the_robots_name() {
        let robots = ["Turtlebot4".to_owned(), "Husky".to_owned()];
        assert_eq!(check("Turtlebot4", &robots), Ok(()));
        assert_eq!(check("Salma", &robots), Ok(()));
        let refused = check("turtlebot4", &robots).err().map(|refused| (refused.code, refused.found.clone()));
        assert_eq!(refused, Some((Code::AlreadyExists, "robot Turtlebot4".to_owned())));
    }
}
