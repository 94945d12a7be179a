//! The three-axis closed loop: time for one simulated second, after one second, a minute and an hour of simulated time.
//!
//! The controller runs at 10 kHz, so 10 000 elements a second is real time.
#![allow(missing_docs, reason = "criterion's macros make undocumented functions")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use flexstage::generator::{GeneratorSettings, Wave};
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};

fn second(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("closed loop, three axes");
    group.throughput(Throughput::Elements(10_000)).sample_size(20);
    for rig in ["handley", "different"] {
        let rig = Rig::named(rig).expect("an embedded rig");
        let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default())
            .expect("an embedded rig has a closed loop");
        stage.arm().expect("a sound stage arms");
        let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
        stage.start(&[(0, sine), (1, sine), (2, sine)]).expect("armed");
        let mut elapsed_s = 0;
        for after_s in [1, 60, 3_600] {
            stage.run((after_s - elapsed_s) * 10_000, |_| {});
            elapsed_s = after_s;
            group.bench_function(format!("{}, after {after_s} s", rig.name), |b| {
                b.iter(|| stage.run(10_000, |_| {}));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, second);
criterion_main!(benches);
