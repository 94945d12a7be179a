//! What experiments write into: the terminal, the report and the list of results.

use indicatif::ProgressBar;
use report::plot::Figure;
use report::{Report, Table};
use serde::Serialize;

use crate::say::say;

/// One result of `bench.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Experiment, plant, controller and motion, separated by slashes.
    pub name: String,
    /// Axis, from 1.
    pub axis: usize,
    /// Distance between the ends of the motion, um.
    pub stroke_um: f64,
    /// Root mean square error of the true position, nm.
    pub rms_nm: f64,
    /// Largest error, nm.
    pub max_nm: f64,
    /// `rms_nm` in percent of the stroke.
    pub rms_percent: f64,
}

impl Outcome {
    /// From an error in nm and a stroke in um.
    pub fn new(
        name: impl Into<String>,
        axis: usize,
        stroke_um: f64,
        rms_nm: f64,
        max_nm: f64,
    ) -> Self {
        Self {
            name: name.into(),
            axis: axis + 1,
            stroke_um,
            rms_nm,
            max_nm,
            rms_percent: rms_nm / stroke_um / 10.0,
        }
    }
}

#[derive(Serialize)]
struct Results {
    experiments: Vec<Outcome>,
}

/// Collects everything.
pub struct Book {
    report: Option<Report>,
    outcomes: Vec<Outcome>,
    bar: ProgressBar,
    /// What went wrong with the terminal first; said at the end, so that experiments need not care.
    failed: Option<anyhow::Error>,
}

impl Book {
    /// Empty.
    pub fn new(bar: ProgressBar) -> Self {
        Self {
            report: Some(Report::new("flexstage bench")),
            outcomes: Vec::new(),
            bar,
            failed: None,
        }
    }

    fn change(&mut self, f: impl FnOnce(Report) -> Report) {
        self.report = self.report.take().map(f);
    }
    fn print(&mut self, text: &str) {
        let said = self.bar.suspend(|| say!("{text}"));
        self.failed = self.failed.take().or(said.err());
    }

    /// Say what is being done.
    pub fn note(&self, message: impl Into<String>) {
        self.bar.set_message(message.into());
    }
    /// Begin a section.
    pub fn section(&mut self, heading: &str) {
        self.print(&format!("\n{heading}"));
        self.change(|report| report.section(heading));
    }
    /// A sentence for the terminal and the report.
    pub fn finding(&mut self, text: &str) {
        self.print(&format!("  {text}"));
        self.change(|report| report.paragraph(text));
    }
    /// Text for the report alone.
    pub fn paragraph(&mut self, text: &str) {
        self.change(|report| report.paragraph(text));
    }
    /// A figure for the report.
    pub fn figure(&mut self, figure: &impl Figure, caption: &str) {
        self.change(|report| report.figure(figure, caption));
    }
    /// Figures side by side.
    pub fn figures(&mut self, figures: Vec<(Box<dyn Figure>, String)>) {
        self.change(|report| report.figures(figures));
    }
    /// A table for the terminal and the report: titles, then rows of cells.
    pub fn table(&mut self, titles: &[&str], rows: &[Vec<String>]) {
        let width = |column: usize| {
            let cells =
                rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
            cells.chain([titles[column].chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..titles.len()).map(width).collect();
        let line = |cells: &mut dyn Iterator<Item = &str>| {
            let cells = cells.zip(&widths).enumerate().map(|(i, (cell, width))| match i {
                0 => format!("{cell:<width$}"),
                _ => format!("{cell:>width$}"),
            });
            format!("  {}", cells.collect::<Vec<_>>().join("  "))
        };
        self.print(&line(&mut titles.iter().copied()));
        for row in rows {
            self.print(&line(&mut row.iter().map(String::as_str)));
        }
        let table = rows.iter().fold(Table::new(titles.iter().copied()), |table, row| {
            table.row(row.iter().map(String::as_str))
        });
        self.change(|report| report.table(table));
    }
    /// Add a result.
    pub fn outcome(&mut self, outcome: Outcome) {
        self.outcomes.push(outcome);
    }
    /// The sentence at the top of the report.
    pub fn verdict(&mut self, text: &str) {
        self.change(|report| report.verdict(text));
    }
    /// The report, the text of `bench.json`, and whether all could be printed.
    pub fn finish(self) -> (Report, String, anyhow::Result<()>) {
        let results = Results { experiments: self.outcomes };
        let text = serde_json::to_string_pretty(&results).unwrap_or_default();
        let report = self.report.unwrap_or_else(|| Report::new("flexstage bench"));
        (report, text, self.failed.map_or(Ok(()), Err))
    }
}
