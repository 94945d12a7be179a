//! The three-axis closed loop: time for one simulated second, from one second to one hour of simulated time.
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
    // The other stage takes several times as long, 64 elements and four sub-steps a tick: an hour of it says nothing more.
    let cases: [(&str, &[u64]); 2] =
        [("handley", &[1, 10, 60, 600, 3_600]), ("different", &[1, 60])];
    for (rig, afters_s) in cases {
        let rig = Rig::named(rig).expect("an embedded rig");
        let mut stage = ClosedLoop::new(&rig, &controller_settings(&rig), Options::default())
            .expect("an embedded rig has a closed loop");
        stage.arm().expect("a sound stage arms");
        let sine = GeneratorSettings::Sine(Wave::between(2.0, 12.0, 10.0));
        stage.start(&[(0, sine), (1, sine), (2, sine)]).expect("armed");
        let started = stage.plant().time_s();
        for &after_s in afters_s {
            // Seconds that criterion has run by itself count too.
            let missing_s = after_s as f64 - (stage.plant().time_s() - started);
            stage.run((missing_s.max(0.0) * 10_000.0) as u64, |_| {});
            group.bench_function(format!("{}, after {after_s} s", rig.name), |b| {
                b.iter(|| stage.run(10_000, |_| {}));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, second);
criterion_main!(benches);
