//! How fast the three-axis closed loop is simulated on one core, and that a long run costs no more per tick than a short one.

use std::time::Instant;

use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

use super::book::Book;

const SECONDS: usize = 60;

/// A clock that runs while this thread does: processor time where the system tells it (Linux), else time on the wall. Other
/// programs run on this machine too, and the question is what one core can do.
struct Clock {
    wall: Instant,
    busy_s: Option<f64>,
}

impl Clock {
    fn start() -> Self {
        Self { wall: Instant::now(), busy_s: busy_s() }
    }
    fn seconds(&self) -> f64 {
        match (self.busy_s, busy_s()) {
            (Some(before), Some(now)) => now - before,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

/// Processor time of this thread, s: the first number of its `schedstat`, in ns.
fn busy_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<u64>().ok()? as f64 * 1.0e-9)
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
        "Three axes in closed loop with noise and converters: {:.0} times real time on one core (processor time; bar 200), {:.0} ns a tick at the start and \
         {:.0} ns after {SECONDS} simulated seconds.",
        1.0 / median(&each_s),
        first * 1.0e5,
        last * 1.0e5
    ));
    Ok(())
}
