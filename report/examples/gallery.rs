//! Every kind of figure on one page: `cargo run --release -p report --example gallery -- FILE.html`.

use report::plot::{Bar, BarPlot, Bode, Figure, HeatMap, LinePlot, Series, Waterfall};
use report::{Report, Table};

fn main() -> std::io::Result<()> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "gallery.html".into());
    let wave = |phase: f64| {
        (0..5000).map(|i| f64::from(i) * 1e-3).map(|t| (t, (6.0 * t + phase).sin())).collect()
    };
    let line = LinePlot::new("Two lines")
        .x("time (s)")
        .y("position (um)")
        .band(-0.1, 0.1)
        .hline(0.5, "limit")
        .vline(2.0, "step")
        .series(Series::line("measured", wave(0.0)))
        .series(Series::dashed("simulated", wave(0.3)));
    let spectrum = LinePlot::new("Residual spectrum")
        .x("frequency (Hz)")
        .y("amplitude (nm)")
        .log_x()
        .log_y()
        .series(Series::stems(
            "residual",
            (0..12).map(|i| (2f64.powi(i), 30.0 / f64::from(i + 1))).collect(),
        ));
    let freq: Vec<f64> = (0..200).map(|i| 10f64.powf(f64::from(i) / 50.0)).collect();
    let db: Vec<f64> = freq.iter().map(|f| -10.0 * (1.0 + (f / 400.0).powi(2)).log10()).collect();
    let phase: Vec<f64> = freq.iter().map(|f| -(f / 400.0).atan().to_degrees()).collect();
    let coherence: Vec<f64> = freq.iter().map(|f| 1.0 / (1.0 + (f / 8000.0).powi(4))).collect();
    let bode = Bode::new("Loop")
        .trace("measured", &freq, &db, &phase)
        .coherence(&freq, &coherence)
        .mark(400.0, "pole");
    let fall = Waterfall::new("Gap", "gap (nm rms)")
        .start("nominal", 82.0)
        .step("creep", 21.0)
        .step("inertia", 5.1)
        .end("left", 5.1)
        .end("floor", 4.0);
    let bars = BarPlot::new("Share")
        .y("share (%)")
        .bar(Bar::new("piezo", 80.0).error(74.0, 86.0))
        .bar(Bar::new("sensor", 20.0).error(14.0, 26.0));
    let map = HeatMap::new("Where it lies")
        .columns(["drive", "amplifier", "piezo", "mechanism", "sensor"])
        .rows(["axis 1", "axis 2", "axis 3"])
        .unit(" %")
        .values(vec![vec![0.0, 1.0, 80.0, 5.0, 0.4], vec![0.1, 0.2, 9.0, 3.0, 0.2], vec![0.0; 5]]);
    Report::new("Gallery")
        .verdict("Every kind of figure, drawn once.")
        .section("Lines")
        .figures([
            (Box::new(line) as Box<dyn Figure>, "Lines with a band."),
            (Box::new(spectrum), "Stems over logarithmic axes."),
        ])
        .figure(&bode, "A frequency response.")
        .section("Bars")
        .figures([
            (Box::new(fall) as Box<dyn Figure>, "A waterfall."),
            (Box::new(bars), "Bars with whiskers."),
        ])
        .figure(&map, "A map.")
        .table(Table::new(["effect", "share"]).row(["creep", "80 %"]).row(["inertia", "20 %"]))
        .details("More", ["Nothing more."])
        .write(path)
}
