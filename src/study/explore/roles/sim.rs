//! The simulator in simulated time.

use std::rc::Rc;

use rangehound_node::world::world_of;
use rangehound_shared::message::WorldEntry;
use rangehound_shared::protocol::wake::WaitGroup;
use rangehound_shared::sealed::slots::SlotWriter;
use rangehound_sim::machine::{Action, Machine, Saved};

use crate::study::explore::cluster::{Cluster, Violation};
use crate::study::explore::message::Message;
use crate::study::explore::node::{FaultEffect, Process};
use crate::study::explore::plan::SIM;

impl Cluster<'_> {
    pub(in crate::study::explore) fn start_sim(&mut self) -> Result<Process, Violation> {
        let world = world_of(self.scenario, std::path::Path::new(""));
        let world = world.map_err(|error| self.violation(Some(SIM), error.to_string()))?;
        let mut machine = Machine::new(self.scenario, world);
        let (saved, writer) = self.sim_disk.read::<Saved<'static>>().map_err(|what| self.violation(Some(SIM), what))?;
        match saved {
            Some(saved) => machine.restore(saved).map_err(|error| self.violation(Some(SIM), error.to_string()))?,
            None if self.checker.has_drives() => {
                return Err(self.violation(Some(SIM), "the state of a tick that was recorded is lost".to_owned()));
            }
            None => {}
        }
        self.sim_writer = writer;
        self.sim_starts += 1;
        // The tick begins again.
        self.forget_first_range();
        self.nodes[SIM].incarnation = self.sim_starts;
        self.checker.timing.sim_starts();
        Ok(Process::Sim(Box::new(machine)))
    }

    pub(in crate::study::explore) fn run_sim(&mut self, mut machine: Box<Machine>) -> Result<Process, Violation> {
        for message in self.take_inbox(SIM) {
            if let Message::Drive(tick, drive) = message {
                machine.on_drive(tick, &drive);
            }
        }
        let now_ns = self.local_ns(SIM);
        while let Some(action) = machine.next_action(now_ns) {
            let effect = self.before_action(SIM)?;
            if let FaultEffect::Dies { written } = effect {
                if action == Action::Save {
                    self.save_sim(&mut machine, written)?;
                }
                return Ok(Process::None);
            }
            self.act_sim(&mut machine, action)?;
            if let FaultEffect::Stops = effect {
                return Ok(Process::Sim(machine));
            }
        }
        self.sleep_until(SIM, machine.wakes_at_ns())?;
        Ok(Process::Sim(machine))
    }

    fn act_sim(&mut self, machine: &mut Machine, action: Action) -> Result<(), Violation> {
        let tick = machine.tick();
        match action {
            Action::Save => self.save_sim(machine, 1.0)?,
            Action::SendWorld => {
                let world = machine.world();
                let sim = &self.nodes[SIM];
                let ran_ns = self.now_ns - sim.stopped_ns;
                let seen = self.checker.world(tick, world.entries());
                let counted_ns = self.now_ns - sim.suspended_ns;
                let seen = seen
                    .and_then(|()| self.checker.timing.world(tick, self.now_ns, [ran_ns, counted_ns], self.late_ns()));
                seen.map_err(|what| self.violation(Some(SIM), what))?;
                self.groups[WaitGroup::Sim as usize].expected = machine.expected();
                self.trace(Some(SIM), || format!("world({tick})"));
                let header = self.header(SIM, tick, world.time_s());
                let entries: Rc<[WorldEntry]> = world.entries().into();
                for receiver in self.plan.commanded() {
                    self.send(SIM, receiver, || Message::World(header, Rc::clone(&entries)));
                }
            }
            Action::Notify(notification) => self.notify(SIM, notification),
            Action::ReportSilent(id) => {
                self.trace(Some(SIM), || format!("goes on without robot-{id}"));
                let sim = &self.nodes[SIM];
                let counted_ns = self.now_ns - sim.suspended_ns;
                let checked = self.checker.timing.leaves_out(tick, counted_ns);
                checked.map_err(|what| self.violation(Some(SIM), what))?;
                self.checker.leaves_out(id);
            }
            Action::Finish => {
                self.is_finished = true;
                self.trace(Some(SIM), || "the run is over".to_owned());
            }
            Action::Record => {
                self.checker.drives(tick, machine.drives()).map_err(|what| self.violation(Some(SIM), what))?;
            }
            Action::SendTruth => {}
        }
        Ok(())
    }

    fn save_sim(&mut self, machine: &mut Machine, share: f64) -> Result<(), Violation> {
        let saved = machine.saved().map_err(|error| self.violation(Some(SIM), error.to_string()))?;
        let writer: &mut SlotWriter = &mut self.sim_writer;
        self.sim_disk.write(writer, &saved, share).map_err(|what| self.violation(Some(SIM), what))
    }
}
