//! The processes and nodes of one run: four ROS 2 graphs, each with its bridge.

use super::driver::{Driver, PERIOD};
use super::turtlebot::{Node, Shared, placed};
use super::wire::Wire;
use super::{POSES, Setting};
use crate::model::course::{User, Waypoint};
use crate::model::link::Link;
use ledger_base::rejection::Rejection;
use ledgerd::demo::Network;
use ledgerd::demo::{FROM_LEDGER, TO_LEDGER};
use ledgerd::demo::{Plan, Route, domains};
use std::time::Instant;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

/// The poses that reach a user.
const POSES_TO_USER: Route = Route { direction: "from_ledger", ..POSES };

/// Everything that runs beside the nodes of the ledger. Dropping it takes the robot away.
pub(crate) struct Stage {
    /// The robot.
    pub body: Shared,
    /// The controllers.
    pub drivers: [Driver; 2],
    /// Waypoints that controllers have reached.
    pub reached: UnboundedReceiver<(Waypoint, Instant)>,
    _base: Node,
    _cameras: Node,
    _wires: Vec<Wire>,
}

impl Stage {
    /// Starts the bridges, over a link if there is one, and the nodes; waits until poses reach both controllers.
    pub(crate) async fn open(network: &mut Network, setting: Setting, link: Option<Link>) -> Result<Self, Rejection> {
        let [of_salma, of_farhad, of_robot, of_cameras] = domains()?;
        let [users_node, robots_node] = network.addresses().clone();
        let mut wires = Vec::new();
        if let Some(link) = link {
            for (name, node) in
                [("Salma", &users_node), ("Farhad", &users_node), ("robot", &robots_node), ("cameras", &robots_node)]
            {
                wires.push(Wire::open(node, link, setting.seed, name).await?);
            }
        }
        let via = |number: usize| wires.get(number).map(|wire| wire.address.as_str());
        let user = [TO_LEDGER, POSES_TO_USER];
        network.start_bridges(&[
            Plan { name: "Salma", domain: of_salma, routes: &user, via: via(0) },
            Plan { name: "Farhad", domain: of_farhad, routes: &user, via: via(1) },
            Plan { name: "Turtlebot4", domain: of_robot, routes: &[FROM_LEDGER], via: via(2) },
            Plan { name: "OptiTrack", domain: of_cameras, routes: &[POSES], via: via(3) },
        ])?;
        let body = placed(setting.course, setting.seed);
        let (told, reached) = unbounded_channel();
        // Half a period apart. With the same beat the later one would be the last word each time, and drive alone.
        let beat = Instant::now();
        let (base, cameras, salma, farhad) = tokio::try_join!(
            Node::base(of_robot, body.clone()),
            Node::cameras(of_cameras, body.clone(), setting.seed),
            Driver::open(of_salma, User::Salma, setting.course, beat, told.clone()),
            Driver::open(of_farhad, User::Farhad, setting.course, beat + PERIOD / 2, told),
        )?;
        tokio::try_join!(
            base.matched(),
            cameras.matched(),
            salma.matched(),
            farhad.matched(),
            network.bridges.found()
        )?;
        Ok(Self { body, drivers: [salma, farhad], reached, _base: base, _cameras: cameras, _wires: wires })
    }

    /// A user's controller.
    pub(crate) fn driver(&self, user: User) -> &Driver {
        let [salma, farhad] = &self.drivers;
        match user {
            User::Salma => salma,
            User::Farhad => farhad,
        }
    }
}
