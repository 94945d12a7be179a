//! The second paper's figures 6 and 7: the measured return of the platform, one mass and two masses.
//!
//! The recordings are simulated (two masses, implicit steps, noise of 4 um) by another route than the one that answers (sums of
//! exponentials); where the independent simulator's recording of figure 6 is at hand, in `../shared`, it is added. The rig
//! that is given has one mass; `diagnose` has to find the second one and its dampers.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use host_sim::platform::{PlatformRig, integrate, presets, statics, time_to_fraction_s};
use rand::{SeedableRng, rngs::SmallRng};
use rand_distr::{Distribution, Normal};
use recording::{Entry, Meta, Recording, Session};
use report::plot::{Figure, LinePlot, Series};

use super::book::{Book, Outcome};

/// Bars of the second paper: misfit of two masses over the noise, of one mass over that of two, error of the dampers, time.
const TWO_MASS_OVER_NOISE: f64 = 1.05;
const ONE_OVER_TWO_MASSES: f64 = 3.0;
const DAMPER_ERROR: f64 = 0.02;
const SECONDS: f64 = 5.0;

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    book.section("Return of a compliant platform (second paper, figures 6 and 7)");
    let planar = [presets::PLANAR_DEFLECTION_M];
    figure(book, "planar, simulated", "belfiore-planar", &planar, 61)?;
    figure(book, "spatial, simulated", "belfiore-spatial", &presets::SPATIAL_DEFLECTIONS_M, 71)?;
    if let Some(folder) =
        shared_data::root().map(|root| root.join("data/platform")).filter(|p| p.is_dir())
    {
        let rig = presets::named("belfiore-planar").context("a preset")?;
        let session = Session::read(&folder, None)?;
        compare(book, "planar, independent simulator", &rig, &session, None)?;
    }
    Ok(())
}

/// One figure of the paper from a simulated session.
fn figure(
    book: &mut Book,
    title: &str,
    name: &str,
    deflections_m: &[f64],
    seed: u64,
) -> anyhow::Result<()> {
    let truth = presets::named(&format!("{name}-two-mass")).context("a preset")?;
    let mut recordings = Vec::new();
    for (index, deflection_m) in deflections_m.iter().enumerate() {
        recordings.push(simulated(&truth, *deflection_m, seed + index as u64)?);
    }
    let given = presets::named(name).context("a preset")?;
    compare(book, title, &given, &Session { recordings, ..Session::default() }, Some(&truth))
}

/// A free return by implicit steps, with noise.
fn simulated(rig: &PlatformRig, deflection_m: f64, seed: u64) -> anyhow::Result<Entry> {
    let times: Vec<f64> = (0..1600).map(|i| f64::from(i) / rig.sample_rate_hz).collect();
    let held = statics::held_positions_m(rig, deflection_m)?;
    let position = integrate::platform_m(rig, &held, &times)?;
    let noise_um = rig.sensor.unwrap_or_default().noise_rms_m * 1.0e6;
    let noise = Normal::new(0.0, noise_um)?;
    let mut rng = SmallRng::seed_from_u64(seed);
    let mut meta = Meta::new("free return", rig.sample_rate_hz);
    meta.initial_position_um = Some(deflection_m * 1.0e6);
    let mut recording = Recording::empty(meta, 1);
    recording.tick = (0..1600).collect();
    recording.drive_v = vec![vec![0.0; 1600]];
    recording.position_um =
        vec![Some(position.iter().map(|m| (m * 1.0e6 + noise.sample(&mut rng)) as f32).collect())];
    let file = format!("{:.2} mm", deflection_m * 1.0e3);
    Ok(Entry { path: PathBuf::from(&file), file, recording })
}

/// One mass as given, one mass refitted and what `diagnose` found, against the same recordings.
fn compare(
    book: &mut Book,
    title: &str,
    given: &PlatformRig,
    session: &Session,
    truth: Option<&PlatformRig>,
) -> anyhow::Result<()> {
    let start = Instant::now();
    let outcome = gap::platform::diagnose(given, session, &gap::Options::default())?;
    let seconds = start.elapsed().as_secs_f64();
    let one = gap::platform::identify(given, session)?.rig;
    let noise_um = outcome.diagnosis.gap.floor_nm / 1.0e3;

    let mut rows = Vec::new();
    let mut figures: Vec<(Box<dyn Figure>, String)> = Vec::new();
    let mut worst = [0.0_f64; 2];
    for entry in &session.recordings {
        let measured = positions(&entry.recording);
        let times: Vec<f64> = (0..entry.recording.len())
            .map(|row| entry.recording.time_s(row) - entry.recording.meta.start_s)
            .collect();
        let start_um = entry.recording.meta.initial_position_um.unwrap_or(0.0);
        let points = |um: &[f64]| times.iter().copied().zip(um.iter().copied()).collect::<Vec<_>>();
        let mut plot = LinePlot::new(format!("{title}: {}", entry.file))
            .x("time after the release (s)")
            .y("position (um)")
            .series(Series::points("measured", points(&measured)).color(0));
        let at = |um: &[f64], fraction: f64| {
            time_to_fraction_s(&times, um, start_um, fraction)
                .map_or("later".to_owned(), |t| format!("{t:.2}"))
        };
        let smooth = gap::platform::picture::smoothed(&measured);
        rows.push(vec![
            format!("{} measured", entry.file),
            format!("{noise_um:.2} (noise)"),
            String::new(),
            at(&smooth, 0.5),
            at(&smooth, 0.1),
            at(&smooth, 0.02),
        ]);
        for (index, (name, rig)) in
            [("one mass", &one), ("two masses", &outcome.rig)].into_iter().enumerate()
        {
            let predicted =
                positions(&gap::platform::replay(rig, &entry.recording, Path::new(&entry.file))?);
            let error: Vec<f64> = predicted.iter().zip(&measured).map(|(a, b)| a - b).collect();
            let rms = (error.iter().map(|e| e * e).sum::<f64>() / error.len() as f64).sqrt();
            let max = error.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
            worst[index] = worst[index].max(rms);
            let series = Series::line(name, points(&predicted)).color(index + 1);
            plot = plot.series(series);
            rows.push(vec![
                format!("{} {name}", entry.file),
                format!("{rms:.2}"),
                format!("{max:.1}"),
                at(&predicted, 0.5),
                at(&predicted, 0.1),
                at(&predicted, 0.02),
            ]);
            book.outcome(Outcome::new(
                format!("platform/{title}/{}/{name}", entry.file),
                0,
                start_um,
                rms * 1.0e3,
                max * 1.0e3,
            ));
        }
        figures.push((
            Box::new(plot),
            format!("{title}, released from {start_um:.0} um; one mass with its best damper, two masses as found."),
        ));
    }
    book.table(
        &["return", "rms (um)", "max (um)", "to 50 % (s)", "to 10 % (s)", "to 2 % (s)"],
        &rows,
    );
    book.figures(figures);
    let cause = outcome.diagnosis.causes.first();
    book.finding(&format!(
        "{title}: {} in {seconds:.2} s (bar {SECONDS} s); two masses leave {:.3} x the noise (bar {TWO_MASS_OVER_NOISE}), one mass \
         {:.1} x that (bar {ONE_OVER_TWO_MASSES}).",
        cause.map_or("nothing found".to_owned(), |c| match c.indistinguishable_from.as_slice() {
            [] => c.effect.clone(),
            others => format!("{} (or {})", c.effect, others.join(" or ")),
        }),
        worst[1] / noise_um,
        worst[0] / worst[1],
    ));
    if let Some(truth) = truth {
        let errors: Vec<f64> = truth
            .masses
            .iter()
            .zip(&outcome.rig.masses)
            .map(|(a, b)| b.damping_n_s_per_m / a.damping_n_s_per_m - 1.0)
            .collect();
        let list: Vec<String> = errors.iter().map(|e| format!("{:+.2} %", 100.0 * e)).collect();
        book.finding(&format!(
            "{title}: dampers off by {} (bar {} %){}.",
            list.join(" and "),
            100.0 * DAMPER_ERROR,
            if errors.iter().all(|e| e.abs() < DAMPER_ERROR) { "" } else { ": MISSED" }
        ));
    }
    Ok(())
}

fn positions(recording: &Recording) -> Vec<f64> {
    let column = recording.position_um.first().and_then(Option::as_ref);
    column.map_or(Vec::new(), |um| um.iter().map(|v| f64::from(*v)).collect())
}
