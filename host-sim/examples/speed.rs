//! Time for a tick of the three-axis closed loop after 1 s to 1 h of simulated time: `cargo run --release -p host-sim --example speed`.
//!
//! One closed loop for each of these times is brought there first; then all are measured by turns, so that whatever else the
//! machine does meets all of them alike.

use std::time::Instant;

use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

const TICKS_A_SECOND: u64 = 10_000;
/// Ticks timed at once, and how often.
const TICKS: u64 = 2_000;
const TURNS: usize = 400;
const AFTER_S: [(&str, u64); 5] =
    [("1 s", 1), ("10 s", 10), ("1 min", 60), ("10 min", 600), ("1 h", 3_600)];

fn main() {
    let rig = Rig::named("handley").expect("an embedded rig");
    let mut loops: Vec<(ClosedLoop, Vec<f64>)> = AFTER_S
        .iter()
        .map(|&(_, seconds)| {
            let settings = controller_settings(&rig);
            let mut stage = ClosedLoop::new(&rig, &settings, Options::default())
                .expect("an embedded rig has a closed loop");
            stage.arm().expect("a sound stage arms");
            let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
            stage.start(&[(0, sine), (1, sine), (2, sine)]).expect("armed");
            stage.run(seconds * TICKS_A_SECOND, |_| {});
            (stage, Vec::with_capacity(TURNS))
        })
        .collect();
    for _ in 0..TURNS {
        for (stage, ns) in &mut loops {
            let start = Instant::now();
            stage.run(TICKS, |_| {});
            ns.push(start.elapsed().as_nanos() as f64 / TICKS as f64);
        }
    }
    println!("simulated   quickest  median (ns a tick)   times real time, median");
    for ((name, _), (_, ns)) in AFTER_S.iter().zip(&mut loops) {
        ns.sort_by(f64::total_cmp);
        let (quickest, median) = (ns[0], ns[TURNS / 2]);
        println!(
            "{name:>9} {quickest:>10.0} {median:>7.0} {:>39.0}",
            1.0e9 / TICKS_A_SECOND as f64 / median
        );
    }
}
