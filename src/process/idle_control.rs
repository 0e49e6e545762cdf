//! Keeps the processors awake while transactions come.
//!
//! A command at 50 Hz meets a machine that has gone to sleep since the last one. Each wait on its way, for the disk and
//! for the next thread, ends with a processor that must wake up first. That takes longer than all the work (see
//! docs/experiments.md). So with the profile `low-latency` the node asks the kernel that no processor sleeps, from the
//! first admitted transaction until a second after the last one. The kernel's way is its PM QoS interface:
//! `/dev/cpu_dma_latency` takes the longest time that waking up may take, in microseconds
//! (Documentation/power/pm_qos_interface.rst). Before admission nothing is asked for: a flood of refused requests must
//! not cost power.

use crate::process::config::Profile;
use ledger_base::rejection::{Code, Rejection};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, park, park_timeout};
use std::time::{Duration, Instant};

/// The kernel's device.
const DEVICE: &str = "/dev/cpu_dma_latency";
/// No processor sleeps.
const AWAKE: i32 = 0;
/// This node asks for nothing (`PM_QOS_DEFAULT_VALUE`).
const ASLEEP: i32 = -1;
/// How long the processors stay awake after the last transaction: a robot that is driven lets them not sleep.
const LINGER: Duration = Duration::from_secs(1);

/// The wish. It ends with the node: the kernel forgets it when the device is closed.
pub(crate) struct IdleControl {
    wish: Option<Arc<Wish>>,
    thread: Option<JoinHandle<()>>,
}

struct Wish {
    device: Mutex<Device>,
    /// The device was told so.
    awake: AtomicBool,
    base: Instant,
    /// Until when, in nanoseconds after `base`.
    until: AtomicU64,
    stop: AtomicBool,
}

struct Device {
    file: File,
    /// Since when it has been told to keep the processors awake, if it is.
    since: Option<Instant>,
    /// How long it was before that.
    before: Duration,
}

impl IdleControl {
    /// For the profile. Where the device cannot be opened, the processors sleep, and the log says so.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub(crate) fn start(profile: Profile) -> io::Result<Self> {
        match profile {
            Profile::Balanced => Ok(Self { wish: None, thread: None }),
            Profile::LowLatency => match OpenOptions::new().write(true).open(DEVICE) {
                Ok(device) => Self::by(device),
                Err(error) => {
                    let reason =
                        Rejection::new(Code::BadConfiguration, "the profile low-latency cannot keep processors awake")
                            .found(format!("{DEVICE}: {error}"))
                            .wanted(format!("write access to {DEVICE}"))
                            .next("give the user of ledgerd write access to it, or use the profile balanced");
                    tracing::warn!(code = reason.code.name(), %reason, "processors may enter sleep states");
                    Ok(Self { wish: None, thread: None })
                }
            },
        }
    }

    fn by(file: File) -> io::Result<Self> {
        let wish = Arc::new(Wish {
            device: Mutex::new(Device { file, since: None, before: Duration::ZERO }),
            awake: AtomicBool::new(false),
            base: Instant::now(),
            until: AtomicU64::new(0),
            stop: AtomicBool::new(false),
        });
        let own = Arc::clone(&wish);
        let thread = std::thread::Builder::new().name("awake".into()).spawn(move || own.let_sleep())?;
        Ok(Self { wish: Some(wish), thread: Some(thread) })
    }

    /// A transaction is in flight.
    pub(crate) fn keep(&self) {
        let (Some(wish), Some(thread)) = (&self.wish, &self.thread) else { return };
        wish.until.store(wish.now() + nanoseconds(LINGER), Ordering::Relaxed);
        if !wish.awake.load(Ordering::Relaxed) {
            wish.tell(|| Some(AWAKE));
            thread.thread().unpark();
        }
    }

    /// For how long the processors were kept awake since the node started.
    pub(crate) fn held(&self) -> Duration {
        self.wish.as_ref().map_or(Duration::ZERO, |wish| {
            let device = wish.device();
            device.before + device.since.map_or(Duration::ZERO, |since| since.elapsed())
        })
    }
}

impl Drop for IdleControl {
    fn drop(&mut self) {
        if let (Some(wish), Some(thread)) = (&self.wish, self.thread.take()) {
            wish.stop.store(true, Ordering::Relaxed);
            thread.thread().unpark();
            let _ended = thread.join();
        }
    }
}

impl Device {
    /// Counts the time.
    fn told(&mut self, awake: bool) {
        self.before += self.since.take().map_or(Duration::ZERO, |since| since.elapsed());
        self.since = awake.then(Instant::now);
    }
}

impl Wish {
    fn now(&self) -> u64 {
        nanoseconds(self.base.elapsed())
    }

    fn device(&self) -> MutexGuard<'_, Device> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the device what is wished, if anything is new.
    fn tell(&self, wished: impl FnOnce() -> Option<i32>) {
        let mut device = self.device();
        let Some(latency) = wished() else { return };
        match device.file.write_all(&latency.to_ne_bytes()) {
            Ok(()) => {
                device.told(latency == AWAKE);
                self.awake.store(latency == AWAKE, Ordering::Relaxed);
            }
            Err(error) => tracing::debug!(%error, "kernel rejected the request to keep processors awake"),
        }
    }

    /// Takes the wish back when nothing came for a while. A transaction that comes just then is served by processors that
    /// may sleep; the next one wakes them again.
    fn let_sleep(&self) {
        while !self.stop.load(Ordering::Relaxed) {
            if !self.awake.load(Ordering::Relaxed) {
                park();
                continue;
            }
            match self.until.load(Ordering::Relaxed).saturating_sub(self.now()) {
                0 => self.tell(|| (self.until.load(Ordering::Relaxed) <= self.now()).then_some(ASLEEP)),
                left => park_timeout(Duration::from_nanos(left)),
            }
        }
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::path::Path;

    /// The values that a device was told.
    fn told(device: &Path) -> Vec<i32> {
        let bytes = std::fs::read(device).unwrap();
        bytes.chunks(4).map(|value| i32::from_ne_bytes(value.try_into().unwrap())).collect()
    }

    #[test]
    fn processors_stay_awake_from_a_transaction_on_until_none_has_come_for_a_while() {
        let directory = tempfile::tempdir().unwrap();
        let device = directory.path().join("device");
        let awake = IdleControl::by(File::create(&device).unwrap()).unwrap();
        assert!(told(&device).is_empty(), "nothing is in flight");
        awake.keep();
        awake.keep();
        assert_eq!(told(&device), [AWAKE], "once");
        let wish = awake.wish.as_ref().unwrap();
        assert!(wish.until.load(Ordering::Relaxed) > wish.now());
        wish.until.store(0, Ordering::Relaxed);
        awake.thread.as_ref().unwrap().thread().unpark();
        while wish.awake.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
        assert_eq!(told(&device), [AWAKE, ASLEEP]);
        awake.keep();
        assert_eq!(told(&device), [AWAKE, ASLEEP, AWAKE]);
    }

    #[test]
    fn the_time_for_which_processors_are_kept_awake_is_counted_and_no_other() {
        let directory = tempfile::tempdir().unwrap();
        let awake = IdleControl::by(File::create(directory.path().join("device")).unwrap()).unwrap();
        assert_eq!(awake.held(), Duration::ZERO, "nothing is in flight");
        let grows = |from| {
            while awake.held() <= from {
                std::thread::yield_now();
            }
        };
        awake.keep();
        grows(Duration::ZERO);
        let wish = awake.wish.as_ref().unwrap();
        wish.tell(|| Some(ASLEEP));
        let held = awake.held();
        assert!(held > Duration::ZERO && awake.held() == held, "{held:?}");
        wish.tell(|| Some(AWAKE));
        grows(held);
    }

    #[test]
    fn the_balanced_profile_wishes_nothing() {
        let awake = IdleControl::start(Profile::Balanced).unwrap();
        awake.keep();
        assert!(awake.wish.is_none() && awake.thread.is_none());
        assert_eq!(awake.held(), Duration::ZERO);
    }
}
