//! The faults, and their times.

use super::{Event, Undo, World};
use crate::clock::{EPOCH, MILLISECOND, SECOND};
use crate::coverage::Fault;
use crate::invariant::Check;
use ledger_raft::{Input, Lane};
use ledger_storage::disk::Fault as DiskFault;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most machines of one run.
const NODES_MAX: usize = 14;

/// Most bytes that are left on a disk that somebody fills.
const LEFT_MAX: u64 = 48 * 1024;

/// The faults that happen at a moment; the others are rates.
const AT_A_MOMENT: [Fault; 24] = [
    Fault::Clog,
    Fault::Partition,
    Fault::OneWay,
    Fault::Crash,
    Fault::TornWrite,
    Fault::Kill,
    Fault::FailedSync,
    Fault::FailedWrite,
    Fault::BitFlip,
    Fault::FullDisk,
    Fault::StateLost,
    Fault::ClockStep,
    Fault::ClockHours,
    Fault::Pause,
    Fault::ClientCrash,
    Fault::Transfer,
    Fault::MembershipChange,
    Fault::Replacement,
    Fault::Hostile,
    Fault::Hostile,
    Fault::Lie,
    Fault::Lie,
    Fault::Pose,
    Fault::Flood,
];

/// How far two clocks are apart at most once everything is healed, microseconds.
const APART: u64 = 1_200 * MILLISECOND;

impl World {
    /// One of the plan's faults happens.
    pub(super) fn misfortune(&mut self) -> Check {
        if !self.chaos {
            return Ok(());
        }
        let next = self.random.faults.around(self.plan.between_faults);
        self.schedule(next, Event::Fault);
        let possible: Vec<Fault> =
            AT_A_MOMENT.iter().copied().filter(|fault| self.plan.faults.contains(fault)).collect();
        let Some(fault) = self.random.faults.pick(&possible).copied() else { return Ok(()) };
        let running: Vec<u64> = self.nodes.values().filter(|node| node.up.is_some()).map(|node| node.id).collect();
        let Some(mut id) = self.random.faults.pick(&running).copied() else { return Ok(()) };
        // What hits the leader is worth more.
        if let Some(leader) = self.leader().filter(|_| self.random.faults.percent(30)) {
            id = leader;
        }
        self.note(format_args!("fault: {} at n{id}", fault.name()));
        match fault {
            Fault::Clog => self.clog(),
            Fault::Partition => self.part(fault),
            Fault::OneWay => self.part(fault),
            Fault::Crash if self.random.faults.percent(8) => {
                // The power of the whole site fails.
                for id in running {
                    self.fell(fault, id, true);
                }
            }
            Fault::Crash => self.fell(fault, id, true),
            Fault::Kill => self.fell(fault, id, false),
            Fault::TornWrite => {
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.tear = true;
                }
            }
            Fault::StateLost => {
                self.fell(fault, id, true);
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.forget_state(self.now);
                }
            }
            Fault::FailedSync => {
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.disk_will_fail = Some(fault);
                    node.disk.fail_sync(self.random.faults.between(1, 3));
                }
            }
            Fault::FailedWrite => {
                let kind = match self.random.faults.below(2) {
                    0 => DiskFault::Error,
                    _ => DiskFault::Short(self.random.faults.below(600) as usize),
                };
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.disk_will_fail = Some(fault);
                    node.disk.fail_write(self.random.faults.between(1, 3), kind);
                }
            }
            Fault::FullDisk => self.fill(id),
            Fault::Flood => self.flood(id),
            Fault::Lie => self.lie(),
            Fault::Pose => self.pose(),
            Fault::BitFlip if self.may_lose(id) => self.flip(id),
            Fault::Replacement if self.may_lose(id) => self.lose(id),
            Fault::ClockStep => self.set_clock(id),
            Fault::ClockHours => self.set_hours_ahead(id),
            Fault::Pause => {
                self.coverage.fault(fault);
                let long = self.random.faults.percent(30);
                let pause = self.random.faults.between(50, if long { 5_000 } else { 600 }) * MILLISECOND;
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.paused_until = self.now + pause;
                }
            }
            Fault::ClientCrash => {
                self.coverage.fault(fault);
                let number = self.random.faults.below(self.clients.len() as u64) as usize;
                self.clients[number].crash();
                let attempt = self.clients[number].attempt;
                let delay = self.random.faults.between(SECOND, 10 * SECOND);
                self.schedule(delay, Event::Client { client: number, attempt });
            }
            Fault::Transfer => return self.hand_over(),
            Fault::MembershipChange => return self.change_members(),
            Fault::Hostile => {
                self.coverage.fault(fault);
                if self.random.faults.percent(30) {
                    self.forges_next = true;
                } else if let Some(transaction) = self.forge() {
                    return self.input(id, Input::Submit { lane: Lane::Data, transaction });
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// The end of a fault.
    pub(super) fn undo(&mut self, undo: Undo) {
        match undo {
            Undo::Cut(name) => self.links.join(name),
            Undo::FullDisk(id) => {
                if let Some(node) = self.nodes.get_mut(&id) {
                    node.disks().iter().for_each(|disk| disk.set_capacity(None));
                    node.shelf.set_full(false);
                }
            }
            Undo::ClockHours => self.set_right(),
        }
    }

    /// From now on nothing goes wrong any more, and what is broken is repaired.
    pub(crate) fn heal(&mut self) {
        self.note(format_args!("everything heals"));
        self.chaos = false;
        self.links.heal();
        self.set_right();
        for id in self.usable() {
            if !self.desired.voters.contains(&id) && !self.desired.learners.contains(&id) {
                // Taken out long ago, and switched off at last.
                self.stop(id, false);
                continue;
            }
            self.undo(Undo::FullDisk(id));
            if let Some(node) = self.nodes.get_mut(&id) {
                node.clock.heal(self.now);
                // Clocks that differ within the bound are no fault.
                node.clock.step(self.now, self.random.faults.below(APART) as i64 - (APART / 2) as i64);
                node.tear = false;
                node.paused_until = node.paused_until.min(self.now);
            }
            // A damaged log is found by looking.
            if self.nodes.get(&id).is_some_and(|node| node.damaged.is_some()) {
                self.stop(id, false);
            }
            let delay = self.random.faults.below(SECOND);
            self.schedule(delay, Event::Start { node: id });
        }
        self.plan.disk_max = MILLISECOND;
        if let Some(robot) = &mut self.robot {
            // From now on its node is honest.
            robot.stream = None;
        }
    }

    /// A process ends, and starts again after a while.
    pub(super) fn fell(&mut self, fault: Fault, id: u64, power_fails: bool) {
        self.coverage.fault(fault);
        self.stop(id, power_fails);
        let soon = self.random.faults.percent(50);
        let long = self.random.faults.percent(8);
        let (short_max, long_max) = (if soon { 100 } else { 8_000 }, 30_000);
        let delay = self.random.faults.between(2, if long { long_max } else { short_max }) * MILLISECOND;
        self.schedule(delay, Event::Start { node: id });
    }

    /// Power fails while the log is written.
    pub(super) fn tear(&mut self, id: u64) {
        self.coverage.fault(Fault::TornWrite);
        if let Some(node) = self.nodes.get_mut(&id) {
            node.tear = false;
            // The first sync of the write, or a later one, if a new segment begins.
            let (disk, left) = (node.disk.clone(), AtomicU64::new(self.random.faults.below(3)));
            node.disk.before_sync(move || {
                if left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err() {
                    disk.crash();
                }
            });
            if let Some(running) = &node.up {
                // The power fails before it returns; the error is heard by nobody.
                let _lost = running.store.flush();
            }
            node.disk.before_sync(|| {});
        }
        self.stop(id, true);
        let delay = self.random.faults.between(2, 2_000) * MILLISECOND;
        self.schedule(delay, Event::Start { node: id });
    }

    fn clog(&mut self) {
        let all = self.usable();
        let (Some(from), Some(to)) = (self.random.faults.pick(&all).copied(), self.random.faults.pick(&all).copied())
        else {
            return;
        };
        self.coverage.fault(Fault::Clog);
        let until = self.now + self.random.faults.between(50, 3_000) * MILLISECOND;
        self.links.clog((from, to), until);
        if self.random.faults.percent(30) {
            // Everything to one node at once: when it goes on, it hears of a world that has gone.
            for from in all {
                self.links.clog((from, to), until);
            }
        }
    }

    fn part(&mut self, fault: Fault) {
        let all = self.usable();
        let mut side: BTreeSet<u64> = all.iter().copied().filter(|_| self.random.faults.percent(40)).collect();
        if let Some(leader) = self.leader().filter(|_| self.random.faults.percent(40)) {
            // The leader with few, or alone.
            side.retain(|_| self.random.faults.percent(50));
            side.insert(leader);
        }
        if side.is_empty() || side.len() == all.len() {
            return;
        }
        self.coverage.fault(fault);
        let mut links = BTreeSet::new();
        for from in &all {
            for to in &all {
                let crosses = side.contains(from) != side.contains(to);
                let counts = fault == Fault::Partition || side.contains(from);
                if crosses && counts {
                    links.insert((*from, *to));
                }
            }
        }
        self.faults += 1;
        self.links.cut(self.faults, links);
        let time = self.random.faults.between(100, 9_000) * MILLISECOND;
        self.schedule(time, Event::Undo(Undo::Cut(self.faults)));
    }

    fn fill(&mut self, id: u64) {
        let time = self.random.faults.between(300, 5_000) * MILLISECOND;
        let left = if self.random.faults.percent(70) { 0 } else { self.random.faults.below(LEFT_MAX) };
        if let Some(node) = self.nodes.get_mut(&id) {
            node.disks().iter().for_each(|disk| disk.set_capacity(Some(disk.used_bytes() + left)));
            node.shelf.set_full(true);
        }
        self.schedule(time, Event::Undo(Undo::FullDisk(id)));
    }

    fn set_clock(&mut self, id: u64) {
        self.coverage.fault(Fault::ClockStep);
        let far = self.random.faults.percent(20);
        let by = self.random.faults.between(1, if far { 300_000 } else { 3_000 }) * MILLISECOND;
        let back = self.random.faults.percent(60);
        let Some(node) = self.nodes.get_mut(&id) else { return };
        let wall = node.clock.wall(self.now);
        // Certificates began a year before, so a clock is never set that far back.
        let by = if back { -(by.min((wall + 3600 * SECOND).saturating_sub(EPOCH)) as i64) } else { by as i64 };
        node.clock.step(self.now, by);
    }

    /// One clock at a time, so that it is never a majority.
    fn set_hours_ahead(&mut self, id: u64) {
        let by = self.random.faults.between(3600 * SECOND, 10 * 3600 * SECOND) as i64;
        let time = self.random.faults.between(SECOND, 12 * SECOND);
        let Some(node) = self.nodes.get_mut(&id).filter(|_| self.hours_ahead.is_none()) else { return };
        node.clock.step(self.now, by);
        self.hours_ahead = Some((id, by));
        self.coverage.fault(Fault::ClockHours);
        self.schedule(time, Event::Undo(Undo::ClockHours));
    }

    fn set_right(&mut self) {
        if let Some((id, by)) = self.hours_ahead.take()
            && let Some(node) = self.nodes.get_mut(&id)
        {
            node.clock.step(self.now, -by);
        }
    }

    fn hand_over(&mut self) -> Check {
        let voters: Vec<u64> = self.newest_members().voters.iter().copied().collect();
        let (Some(leader), Some(to)) = (self.leader(), self.random.faults.pick(&voters).copied()) else {
            return Ok(());
        };
        self.coverage.fault(Fault::Transfer);
        self.input(leader, Input::TransferLeadership { to })
    }

    /// The operator wants other members: a voter becomes a learner, a learner a voter, a new learner comes, an old one
    /// goes. At least three voters stay. The leader does it, whoever leads.
    fn change_members(&mut self) -> Check {
        if self.replacement.is_some() || !self.is_settled() {
            return Ok(());
        }
        let random = &mut self.random.faults;
        let learners: Vec<u64> = self.desired.learners.iter().copied().collect();
        let voters: Vec<u64> = self.desired.voters.iter().copied().collect();
        let (learner, voter) = (random.pick(&learners).copied(), random.pick(&voters).copied());
        match (random.below(5), learner, voter) {
            (0, Some(learner), _) => {
                self.desired.learners.remove(&learner);
                self.desired.voters.insert(learner);
            }
            (1, _, Some(voter)) if voters.len() > 3 => {
                self.desired.voters.remove(&voter);
                self.desired.learners.insert(voter);
            }
            (2, Some(learner), Some(voter)) => {
                self.desired.learners.remove(&learner);
                self.desired.voters.remove(&voter);
                self.desired.learners.insert(voter);
                self.desired.voters.insert(learner);
            }
            (3, Some(learner), _) => {
                self.desired.learners.remove(&learner);
            }
            (4, ..) if self.nodes.len() < NODES_MAX && self.may_come(None) => {
                let new = self.newcomer();
                self.desired.learners.insert(new);
            }
            _ => return Ok(()),
        }
        self.coverage.fault(Fault::MembershipChange);
        let desired = format!("{:?}", self.desired);
        self.note(format_args!("members wanted: {desired}"));
        Ok(())
    }
}
