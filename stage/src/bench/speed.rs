//! How fast the three-axis closed loop is simulated on one core, and that a long run costs no more per tick than a short one.

use std::time::Duration;

use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

use super::book::Book;

const SECONDS: usize = 60;

/// A clock that runs while this thread does: processor time where the system tells it, else time on the wall. Other
/// programs run on this machine too, and the question is what one core can do.
struct Clock(Duration);

impl Clock {
    fn start() -> Self {
        Self(now())
    }
    fn seconds(&self) -> f64 {
        now().saturating_sub(self.0).as_secs_f64()
    }
}

/// To the nanosecond. The number in `/proc/thread-self/schedstat` would do without a crate, but moves by 4 ms at a time.
#[cfg(unix)]
fn now() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

#[cfg(not(unix))]
fn now() -> Duration {
    static START: std::sync::LazyLock<std::time::Instant> =
        std::sync::LazyLock::new(std::time::Instant::now);
    START.elapsed()
}

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let rig = Rig::named("handley").expect("an embedded rig");
    let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default())?;
    stage.arm()?;
    let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
    stage.start(&[(0, sine), (1, sine), (2, sine)])?;
    let mut each_s = Vec::new();
    for _ in 0..SECONDS {
        let clock = Clock::start();
        stage.run(10_000, |_| {});
        each_s.push(clock.seconds());
    }
    // The median of each third: a shared core is slowed down by its neighbours' caches.
    let median = |part: &[f64]| {
        let mut part = part.to_vec();
        part.sort_by(f64::total_cmp);
        part[part.len() / 2]
    };
    let (first, last) = (median(&each_s[..SECONDS / 3]), median(&each_s[SECONDS - SECONDS / 3..]));
    book.section("Speed of the simulation");
    book.finding(&format!(
        "Three axes in closed loop with noise and converters: {:.0} times real time on one core (processor time, median; {:.0} in the quickest \
         second; bar 200), {:.0} ns a tick at the start and {:.0} ns after {SECONDS} simulated seconds.",
        1.0 / median(&each_s),
        1.0 / each_s.iter().copied().fold(f64::INFINITY, f64::min),
        first * 1.0e5,
        last * 1.0e5
    ));
    Ok(())
}
