//! Speed of the plant alone: `cargo bench -p host-sim`. One session is 30 s of three axes at 10 kHz.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use host_sim::{Axes, Input, Options, Place, Plant, Rig, simulate};

fn drives(seconds: usize) -> Vec<Vec<f64>> {
    let triangle = |t: f64| 90.0 * (1.0 - (2.0 * t.rem_euclid(1.0) - 1.0).abs());
    (0..3)
        .map(|axis| {
            (0..seconds * 10_000)
                .map(|i| triangle(i as f64 * 1e-4 * f64::from(1 + 5 * axis)))
                .collect()
        })
        .collect()
}

fn batch(criterion: &mut Criterion) {
    let drives = drives(10);
    let drives: Vec<&[f64]> = drives.iter().map(Vec::as_slice).collect();
    let input = Input {
        sample_rate_hz: 10_000.0,
        start_s: 0.0,
        ticks: None,
        drive_v: &drives,
        monitor_v: None,
        initial: &[],
    };
    let nominal = Rig::named("handley").unwrap();
    let mut creeping = nominal.clone();
    let mut coupled = nominal.clone();
    let mut hardening = nominal.clone();
    for axis in 0..3 {
        creeping.set("creep", Place::Axis(axis), "per_decade", 0.015).unwrap();
        hardening.set("stiffness-hardening", Place::Axis(axis), "cubic_n_per_m3", 5e15).unwrap();
        let pair = Place::Pair { on: axis, from: (axis + 1) % 3 };
        coupled.set("stiffness-coupling", pair, "stiffness_n_per_m", 1.4e5).unwrap();
    }
    let different = Rig::named("different").unwrap();
    let mut group = criterion.benchmark_group("axis-tick");
    group.throughput(Throughput::Elements(3 * 100_000));
    group.sample_size(10);
    for (name, rig) in [
        ("nominal", &nominal),
        ("creep", &creeping),
        ("hardening", &hardening),
        ("coupled", &coupled),
        ("different", &different),
    ] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| simulate(black_box(rig), &input, Axes::All).unwrap());
        });
    }
    group.finish();
}

fn closed(criterion: &mut Criterion) {
    let mut plant = Plant::new(&Rig::named("handley").unwrap(), Options::default()).unwrap();
    let drives = drives(1);
    let mut tick = 0;
    let mut group = criterion.benchmark_group("plant with noise");
    group.throughput(Throughput::Elements(3));
    group.bench_function("step", |bencher| {
        bencher.iter(|| {
            tick = (tick + 1) % 10_000;
            plant.step(&[drives[0][tick], drives[1][tick], drives[2][tick]])[0]
        });
    });
    group.finish();
}

criterion_group!(benches, batch, closed);
criterion_main!(benches);
