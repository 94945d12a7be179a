//! The controller on motions of 10 um, from linear open loop to full control, on a stage as modelled and on one that is not.
//!
//! The different stage is known to the controller only through [`identification`](super::identification) of recordings
//! of it. All three axes run at once; errors are reference less true position, over whole periods after the start.

use std::collections::BTreeMap;

use flexstage::generator::{GeneratorSettings, Wave};
use flexstage::settings::{AxisSettings, FeedbackSettings};
use flexstage::{AXES, Settings};
use gap::ForControl;
use host_sim::closed_loop::ClosedLoop;
use host_sim::{Options, Rig, controller_settings};
use report::plot::{Bar, BarPlot, LinePlot, Series};

use super::book::{Book, Outcome};
use super::identification;

/// Ends of the motions, um.
#[derive(Clone, Copy)]
pub struct Ends {
    pub low_um: f32,
    pub high_um: f32,
}

impl Ends {
    const OF_THE_PAPER: Self = Self { low_um: 2.0, high_um: 12.0 };

    fn stroke_um(self) -> f64 {
        f64::from(self.high_um - self.low_um)
    }
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Form {
    Triangle,
    Sine,
}

#[derive(Clone, Copy)]
pub(super) struct Case {
    form: Form,
    hz: f32,
}

impl Case {
    fn name(self) -> String {
        let form = if self.form == Form::Triangle { "triangle" } else { "sine" };
        format!("{form} {} Hz", self.hz)
    }
    fn generator(self, ends: Ends) -> GeneratorSettings {
        let wave = Wave::between(ends.low_um, ends.high_um, self.hz);
        if self.form == Form::Triangle {
            GeneratorSettings::Triangle(wave)
        } else {
            GeneratorSettings::Sine(wave)
        }
    }
}

const CASES: [Case; 6] = [
    Case { form: Form::Triangle, hz: 1.0 },
    Case { form: Form::Triangle, hz: 10.0 },
    Case { form: Form::Triangle, hz: 50.0 },
    Case { form: Form::Sine, hz: 1.0 },
    Case { form: Form::Sine, hz: 10.0 },
    Case { form: Form::Sine, hz: 100.0 },
];

/// Error of one axis in one run.
#[derive(Clone, Default)]
struct Errors {
    rms_nm: f64,
    max_nm: f64,
    /// Time (periods), reference (um), error (nm) over the last period.
    trace: Vec<(f64, f64, f64)>,
}

/// The controllers that are compared: name and settings.
pub(super) fn controllers(
    rig: &Rig,
    lines: &[(f64, f64)],
    coarse: bool,
) -> Vec<(&'static str, Settings)> {
    let mut full = controller_settings(rig);
    if coarse {
        identification::coarse_converters(&mut full);
    }
    let each = |f: &dyn Fn(usize, &mut AxisSettings)| {
        let mut settings = full.clone();
        for (k, axis) in settings.axes.iter_mut().enumerate() {
            f(k, axis);
        }
        settings
    };
    let mut linear = each(&|k, axis| {
        let (v_per_um, offset_v) = lines[k];
        let converters = (axis.gauge.clone(), axis.monitor.clone(), axis.dac.clone());
        *axis = AxisSettings::open_loop(v_per_um as f32);
        axis.origin_um = (-offset_v / v_per_um) as f32;
        (axis.gauge, axis.monitor, axis.dac) = converters;
    });
    linear.cross_stiffness_n_per_m = Default::default();
    let stiffness = each(&|_, axis| {
        axis.feedforward.hysteresis = false;
        axis.feedforward.creep.clear();
        axis.feedback = FeedbackSettings::default();
    });
    let hysteresis = each(&|_, axis| axis.feedback = FeedbackSettings::default());
    let pd = each(&|_, axis| axis.feedback.integral_v_per_um_s = 0.0);
    vec![
        ("linear open loop", linear),
        ("stiffness feedforward", stiffness),
        ("+ hysteresis", hysteresis),
        ("+ PD", pd),
        ("+ integral", full),
    ]
}

/// Errors of the axes, or the fault that ended it.
fn track(
    stage: &Rig,
    settings: &Settings,
    (case, ends): (Case, Ends),
    seed: u64,
) -> anyhow::Result<Result<Vec<Errors>, String>> {
    let mut settings = settings.clone();
    for axis in &mut settings.axes {
        // Feedforward alone may be far off: that is a result here, not a fault.
        axis.limits.following_error_um = 0.0;
    }
    let mut bench = ClosedLoop::new(stage, &settings, Options { seed, ..Options::default() })?;
    let generators: Vec<_> = (0..AXES as u8).map(|axis| (axis, case.generator(ends))).collect();
    if let Err(fault) = bench.arm().and_then(|()| bench.start(&generators)) {
        return Ok(Err(fault.to_string()));
    }
    let period = (10_000.0 / case.hz).round() as u64;
    bench.run(3 * period.max(3_000), |_| {});
    let scored = period * (10_000 / period).max(3);
    let mut errors = vec![Errors::default(); AXES];
    let mut n = 0;
    bench.run(scored, |step| {
        n += 1;
        for (axis, errors) in errors.iter_mut().enumerate() {
            let reference = step.record.axes[axis].reference.to_f64();
            let error = (reference - step.true_um[axis]) * 1.0e3;
            errors.rms_nm += error * error;
            errors.max_nm = errors.max_nm.max(error.abs());
            if axis == 0 && n > scored - period {
                errors.trace.push(((n + period - scored) as f64 / period as f64, reference, error));
            }
        }
    });
    for errors in &mut errors {
        errors.rms_nm = (errors.rms_nm / scored as f64).sqrt();
    }
    let faults: Vec<_> = bench.controller().faults().describe().collect();
    Ok(if faults.is_empty() { Ok(errors) } else { Err(faults.join("; ")) })
}

/// Run the experiment.
pub fn run(book: &mut Book) -> anyhow::Result<()> {
    let nominal = Rig::named("handley").expect("an embedded rig");
    let different = Rig::named("different").expect("an embedded rig");

    book.note("tracking: identification");
    let modelled = identification::identify(&nominal, &nominal, 101)?;
    let known = controllers(&nominal, &lines(&modelled), false);
    let found = identification::identify(&different, &nominal, 102)?;
    let learned = controllers(&found.rig, &lines(&found), true);

    let ends = Ends::OF_THE_PAPER;
    let full = table(book, "Tracking, stage as modelled", ("nominal", &nominal), &known, ends)?;
    summary(book, "nominal", &full);
    identification_section(book, &found);
    let full = table(book, "Tracking, different stage", ("different", &different), &learned, ends)?;
    summary(book, "different", &full);
    learned_verdict(book, &full);
    Ok(())
}

/// Best straight line of each axis: V/um, and V at zero.
fn lines(found: &ForControl) -> Vec<(f64, f64)> {
    let axes = found.axes.iter().flatten();
    axes.map(|f| (f.inverse.linear_v_per_um, f.inverse.linear_v)).collect()
}

fn identification_section(book: &mut Book, found: &ForControl) {
    book.section("Identification of the different stage");
    book.paragraph(
        "Another stage of the same kind: 64 unevenly spaced slip elements, asymmetric and rate-dependent loops, creep, amplifiers \
         limited to 0.4 A, a lightly damped mode at 1.6 kHz, 4 nm of gauge noise, 12-bit converters. The controller knows of it \
         what `flexstage identify --for-control` finds in 33 s of open-loop recordings. Last thirds were not fitted.",
    );
    let rows: Vec<Vec<String>> = found
        .axes
        .iter()
        .enumerate()
        .filter_map(|(axis, found)| Some((axis, found.as_ref()?)))
        .map(|(axis, f)| {
            let or_dash = |x: Option<String>| x.unwrap_or_else(|| "-".into());
            vec![
                format!("{}", axis + 1),
                format!("{:.2}", f.inverse.linear_misfit_v),
                format!("{:.3}", f.inverse.misfit_v),
                format!("{:.3}", f.inverse.held_out_v),
                or_dash(f.lag.mode.map(|m| format!("{:.0}", m.resonance_hz))),
                or_dash(f.lag.time_constant_s.map(|t| format!("{:.3}", t.value * 1.0e3))),
                or_dash(f.creep.map(|c| format!("{:.2}", c.per_decade * 100.0))),
            ]
        })
        .collect();
    book.table(
        &[
            "axis",
            "straight line (V rms)",
            "slip elements (V rms)",
            "last third (V rms)",
            "resonance (Hz)",
            "amplifier (ms)",
            "creep (% a decade)",
        ],
        &rows,
    );
    for note in &found.notes {
        book.paragraph(note);
    }
}

/// One controller on one motion.
pub(super) struct Run {
    controller: &'static str,
    /// Of the axis that does worst, as in the table.
    pub(super) worst_percent: f64,
    /// Error of the first axis over a period, for the figures.
    trace: Vec<(f64, f64)>,
}

/// All controllers, a motion each.
pub(super) type Full = Vec<(Case, Vec<Run>)>;

pub(super) fn table(
    book: &mut Book,
    heading: &str,
    (plant, stage): (&str, &Rig),
    controllers: &[(&'static str, Settings)],
    ends: Ends,
) -> anyhow::Result<Full> {
    book.section(heading);
    book.paragraph(&format!(
        "Three axes at once, {} to {} um; rms error of the true position in percent of the stroke, worst axis (nm in brackets).",
        ends.low_um, ends.high_um,
    ));
    let stroke_um = ends.stroke_um();
    let mut full = Vec::new();
    let mut rows = Vec::new();
    let mut faults: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for case in CASES {
        book.note(format!("tracking: {plant} stage, {}", case.name()));
        let mut row = vec![case.name()];
        let mut by_controller = Vec::new();
        for (name, settings) in controllers {
            let errors = match track(stage, settings, (case, ends), 200)? {
                Ok(errors) => errors,
                Err(fault) => {
                    row.push("fault".into());
                    faults.entry(fault).or_default().push(format!("{name} on {}", case.name()));
                    by_controller.push(Run {
                        controller: name,
                        worst_percent: f64::NAN,
                        trace: Vec::new(),
                    });
                    continue;
                }
            };
            let worst = errors.iter().map(|e| e.rms_nm).fold(0.0, f64::max);
            row.push(format!("{:.3} ({worst:.1})", worst / stroke_um / 10.0));
            for (axis, e) in errors.iter().enumerate() {
                let name = format!("tracking/{plant}/{name}/{}", case.name());
                book.outcome(Outcome::new(name, axis, stroke_um, e.rms_nm, e.max_nm));
            }
            by_controller.push(Run {
                controller: name,
                worst_percent: worst / stroke_um / 10.0,
                trace: errors[0].trace.iter().map(|(t, _, e)| (*t, *e)).collect(),
            });
        }
        rows.push(row);
        full.push((case, by_controller));
    }
    let titles: Vec<&str> =
        ["motion"].into_iter().chain(controllers.iter().map(|(name, _)| *name)).collect();
    book.table(&titles, &rows);
    for (fault, with) in &faults {
        book.finding(&format!("The loop opened with {}: {fault}.", with.join("; ")));
    }
    Ok(full)
}

pub(super) fn summary(book: &mut Book, plant: &str, full: &Full) {
    let mut figures: Vec<(Box<dyn report::plot::Figure>, String)> = Vec::new();
    for (case, runs) in full.iter().filter(|(case, _)| case.form == Form::Sine) {
        let mut plot = LinePlot::new(format!("{}, {plant} stage", case.name()))
            .x("time (periods)")
            .y("reference - true position (nm)");
        for (i, run) in runs.iter().enumerate().filter(|(i, run)| *i >= 2 && !run.trace.is_empty())
        {
            plot = plot.series(Series::line(run.controller, run.trace.clone()).color(i - 2));
        }
        figures.push((
            Box::new(plot),
            format!("Error of axis 1 over a period of the {}.", case.name()),
        ));
    }
    let mut bars = BarPlot::new(format!("Sine of 10 Hz, {plant} stage"))
        .y("rms error of the worst axis (% of stroke)");
    if let Some((_, runs)) =
        full.iter().find(|(case, _)| case.form == Form::Sine && case.hz == 10.0)
    {
        for run in runs.iter().filter(|run| run.worst_percent.is_finite()) {
            bars = bars.bar(Bar::new(run.controller, run.worst_percent));
        }
    }
    figures.push((Box::new(bars), "What each part of the controller buys.".to_string()));
    book.figures(figures);
}

/// Worst of the axes with one controller (from 0) on one motion, % of the stroke.
pub(super) fn percent(full: &Full, form: Form, hz: f32, controller: usize) -> f64 {
    full.iter()
        .find(|(case, _)| case.form == form && case.hz == hz)
        .map_or(f64::NAN, |(_, runs)| runs[controller].worst_percent)
}

fn learned_verdict(book: &mut Book, full: &Full) {
    let percent = |hz, controller| percent(full, Form::Sine, hz, controller);
    book.verdict(&format!(
        "On a stage that it knows from a recording only, the controller follows 10 um sines with {:.3} % rms error at 1 Hz, \
         {:.3} % at 10 Hz and {:.3} % at 100 Hz; its feedforward alone reaches {:.2} % at 1 Hz. Worst of three axes that \
         move at once.",
        percent(1.0, 4),
        percent(10.0, 4),
        percent(100.0, 4),
        percent(1.0, 2),
    ));
}
