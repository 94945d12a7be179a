use flexstage::{GeneratorSettings, Settings, generator::Wave, settings::*};
use host_sim::{Options, Place, Rig, closed_loop::ClosedLoop, controller_settings, tuning};

fn different() -> Rig {
    let mut rig = Rig::named("handley").unwrap();
    for k in 0..3 {
        let a = &mut rig.axes[k];
        a.piezo.hysteresis.capacitance_f.clear();
        a.piezo.hysteresis.limit_v.clear();
        let mut x: u32 = 12345 + k as u32;
        for i in 0..64 {
            x = x.wrapping_mul(1664525).wrapping_add(1013904223);
            let r = (x >> 8) as f64 / (1 << 24) as f64;
            let slip = 110e-6 * ((i as f64 + r) / 64.0).powf(1.4) + 1e-6;
            let k_i = 230e3 / 64.0 * (0.6 + 0.8 * r);
            a.piezo.hysteresis.capacitance_f.push(1.0 / k_i);
            a.piezo.hysteresis.limit_v.push(k_i * slip);
        }
        a.sensor.resolution_m = 0.0;
        let p = Place::Axis(k);
        rig.set("hysteresis-shape", p, "skew", 0.05).unwrap();
        rig.set("hysteresis-rate", p, "per_decade", 0.03).unwrap();
        rig.set("creep", p, "per_decade", 0.01).unwrap();
        rig.set("amplifier-current-limit", p, "current_a", 0.4).unwrap();
        rig.set("inertia", p, "added_kg", 0.53).unwrap();
        rig.set("inertia", p, "added_damping_n_s_per_m", 150.0).unwrap();
    }
    rig
}

fn rms(rig: &Rig, settings: &Settings, generator: GeneratorSettings, hz: f64) -> (f64, f64, f64) {
    let mut stage =
        ClosedLoop::new(rig, settings, Options { seed: 3, ..Options::default() }).unwrap();
    if let Err(e) = stage.arm() {
        println!("ARM {e}");
        return (f64::NAN, 0.0, 0.0);
    }
    stage.start(&[(0, generator)]).unwrap();
    let period = (10_000.0 / hz) as u64;
    let settle = 3 * period.max(3_000);
    stage.run(settle, |_| {});
    let n = 4 * period.max(2_500);
    let (mut s, mut worst, mut mean) = (0.0, 0.0f64, 0.0);
    let mut flags = 0;
    stage.run(n, |step| {
        let e = (step.record.axes[0].reference.to_f64() - step.true_um[0]) * 1e3;
        s += e * e;
        mean += e;
        worst = worst.max(e.abs());
        flags |= step.record.flags.0;
    });
    if flags >> 8 != 0 {
        print!("[flags {:x}]", flags);
    }
    ((s / n as f64).sqrt(), worst, mean / n as f64)
}

fn main() {
    let different = different();
    let nominal = Rig::named("handley").unwrap();
    for (name, rig) in [("nominal", &nominal), ("different", &different)] {
        let base = controller_settings(rig);
        let args: Vec<f32> = std::env::args().skip(1).map(|a| a.parse().unwrap()).collect();
        let mut fb = base.clone();
        for a in &mut fb.axes {
            if name == "different" {
                a.gauge.full_code = 4095;
            }
            if let [p, i, d, adv, damp] = args[..] {
                let vpu = 7.52;
                a.feedback.proportional_v_per_um = p * vpu;
                a.feedback.integral_v_per_um_s = i * vpu;
                a.feedback.derivative_v_ms_per_um = d * vpu;
                a.feedforward.advance_s = adv;
                for n in &mut a.feedback.notches {
                    n.damping_ratio = damp;
                }
            }
        }
        let mut ff = fb.clone();
        for a in &mut ff.axes {
            a.feedback = FeedbackSettings::default();
        }
        for hz in [1.0, 10.0, 50.0, 100.0] {
            for tri in [true, false] {
                if tri && hz == 100.0 || !tri && hz == 50.0 {
                    continue;
                }
                let w = Wave::between(0.0, 10.0, hz as f32);
                let g =
                    if tri { GeneratorSettings::Triangle(w) } else { GeneratorSettings::Sine(w) };
                let (a, aw, am) = rms(rig, &ff, g, hz);
                let (b, bw, bm) = rms(rig, &fb, g, hz);
                println!(
                    "{name:10} {:8} {hz:5} Hz  ff {a:8.1} max {aw:8.1} mean {am:7.1} ({:.3} %)   full {b:8.1} max {bw:8.1} mean {bm:6.1} ({:.3} %)",
                    if tri { "triangle" } else { "sine" },
                    a / 100.0,
                    b / 100.0
                );
            }
        }
    }
}
