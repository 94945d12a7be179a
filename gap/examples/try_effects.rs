//! Fit chosen effects to a session and print what they leave: `try_effects RIG SESSION effect[,effect] ...`.
use gap::scene::{Channel, Scene, TOLERANCE, Wanted};
use gap::select::{Search, start_terms};
use host_sim::rig::Rig;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let rig = Rig::load(std::path::Path::new(&args[1])).unwrap();
    let session = recording::Session::read(std::path::Path::new(&args[2]), None).unwrap();
    let mut scene = Scene::new(&rig, gap::intake::tracks(&rig, &session).unwrap());
    gap::split::split(&mut scene, &[]);
    scene.set_aside_memory(&rig).unwrap();
    let all = |_: &Channel| true;
    let nominal = scene.residuals(&[(&rig, Wanted::ALL)], all).unwrap().remove(0);
    let raw = scene.raw(&rig, all).unwrap();
    for (c, channel) in scene.channels.iter_mut().enumerate() {
        let power = channel.band_power(nominal[c].as_ref().unwrap());
        channel.weigh(&power, TOLERANCE);
    }
    for (a, n) in scene.position_noise.iter().enumerate() {
        println!("axis {} {:?}", a + 1, n);
    }
    println!(
        "held out {:?}",
        (0..scene.tracks.len())
            .filter(|t| scene.channels.iter().any(|c| c.track == *t && c.held_out))
            .map(|t| &scene.tracks[t].file)
            .collect::<Vec<_>>()
    );
    let ranges = gap::guess::ranges(&scene, &rig, &raw).unwrap();
    println!("{ranges:?}");
    let fitted = |c: &Channel| !c.held_out;
    let tick = || ();
    for set in &args[3..] {
        let effects: Vec<_> = set.split(',').map(|n| host_sim::effects::find(n).unwrap()).collect();
        let t0 = std::time::Instant::now();
        let search = Search::new(&scene, &rig, &effects, &ranges, &fitted, &tick).unwrap();
        let gains = search.screen.test(&scene, &search.base, None);
        let mut known = vec![];
        let mut last = None;
        for (k, &e) in effects.iter().enumerate() {
            let g = if let Some(m) = &last {
                let m: &gap::select::Model = m;
                let s = gap::fit::Sensitivities::at(
                    &scene,
                    &rig,
                    &m.fit.knobs,
                    &m.fit.values,
                    &m.fit.stack,
                    &fitted,
                )
                .unwrap();
                search.screen.test(&scene, &m.fit.stack, Some(&s))[k].clone()
            } else {
                gains[k].clone()
            };
            for x in &g {
                println!(
                    "   {} {:?} gain {:.0} start {:?}",
                    e.info().name,
                    x.place,
                    x.gain,
                    x.start
                );
            }
            let model = search.fit_terms(&known, e, &g).unwrap();
            println!(
                "{} left {:.0} of {:.0} noise {:.0} explains {:.4} in {:.1?}",
                model.key().join("+"),
                model.fit.cost - search.noise,
                search.gap,
                search.noise,
                1.0 - (model.fit.cost - search.noise) / search.gap,
                t0.elapsed()
            );
            for (knob, v) in model.fit.knobs.iter().zip(&model.fit.values) {
                if let gap::knobs::Target::Effect { effect, place, index } = &knob.target {
                    println!(
                        "      {} {:?} {} = {:.5e}",
                        effect.info().name,
                        place,
                        effect.info().parameters[*index].name,
                        v
                    );
                }
            }
            known = start_terms(&model);
            last = Some(model);
        }
    }
}
