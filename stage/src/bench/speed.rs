//! How fast the three-axis closed loop is simulated on one core, and that a long run costs no more per tick than a short one.

use std::time::Instant;

use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

use super::book::Book;

const SECONDS: usize = 30;

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let rig = Rig::named("handley").expect("an embedded rig");
    let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default())?;
    stage.arm()?;
    let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
    stage.start(&[(0, sine), (1, sine), (2, sine)])?;
    let mut each_s = Vec::new();
    for _ in 0..SECONDS {
        let start = Instant::now();
        stage.run(10_000, |_| {});
        each_s.push(start.elapsed().as_secs_f64());
    }
    // The median of each third: other programs run on this machine too.
    let median = |part: &[f64]| {
        let mut part = part.to_vec();
        part.sort_by(f64::total_cmp);
        part[part.len() / 2]
    };
    let (first, last) = (median(&each_s[..SECONDS / 3]), median(&each_s[SECONDS - SECONDS / 3..]));
    book.section("Speed of the simulation");
    book.finding(&format!(
        "Three axes in closed loop with noise and converters: {:.0} times real time on one core, {:.0} ns a tick at the start and \
         {:.0} ns after {SECONDS} simulated seconds.",
        1.0 / median(&each_s),
        first * 1.0e5,
        last * 1.0e5
    ));
    Ok(())
}
