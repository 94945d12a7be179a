//! Self-contained HTML reports with plots that could go into a paper.
//!
//! A [`Report`] is a list of sections with paragraphs, tables and figures; it is one HTML file without scripts, fonts or
//! links to anything outside itself, so that it can be mailed, archived and opened anywhere. Figures are inline SVG
//! drawn by `plotters`; see [`plot`].
//!
//! ```
//! use report::{Report, Table, plot::{LinePlot, Series}};
//!
//! let line = LinePlot::new("Return").x("time (s)").y("position (um)")
//!     .series(Series::line("measured", vec![(0.0, 1.0), (1.0, 0.4)]));
//! let html = Report::new("A return")
//!     .verdict("It comes back.")
//!     .section("Data")
//!     .figure(&line, "Position after release.")
//!     .table(Table::new(["time (s)", "position (um)"]).row(["0", "1.0"]))
//!     .to_html();
//! assert!(html.contains("<svg") && html.contains("It comes back."));
//! ```

use std::io::{self, Write};
use std::path::Path;

use maud::{DOCTYPE, Markup, PreEscaped, html};

pub mod plot;

use plot::Figure;

const STYLE: &str = include_str!("style.css");

/// A report under construction: call the methods in reading order, then [`Report::write`].
pub struct Report {
    title: String,
    verdict: Option<String>,
    body: Vec<Markup>,
}

/// A table of text cells, a header row first.
pub struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table with these column titles.
    pub fn new<T: Into<String>>(header: impl IntoIterator<Item = T>) -> Self {
        Self { header: header.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Add one row; cells that look like numbers are set flush right.
    #[must_use]
    pub fn row<T: Into<String>>(mut self, cells: impl IntoIterator<Item = T>) -> Self {
        self.rows.push(cells.into_iter().map(Into::into).collect());
        self
    }

    fn markup(&self) -> Markup {
        html! {
            div.scroll { table {
                thead { tr { @for cell in &self.header { th { (cell) } } } }
                tbody { @for row in &self.rows { tr { @for cell in row {
                    td.num[is_number(cell)] { (cell) }
                } } } }
            } }
        }
    }
}

/// A cell is set as a number when it starts like one: digits, a sign, a bracket before a digit.
fn is_number(cell: &str) -> bool {
    let text = cell.trim_start_matches(['-', '+', '−', '<', '>', '≤', '≥', '±', '~', '[', ' ']);
    text.starts_with(|c: char| c.is_ascii_digit())
}

impl Report {
    /// A report without sections yet.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), verdict: None, body: Vec::new() }
    }

    /// The one sentence that a reader in a hurry takes away; stands under the title.
    #[must_use]
    pub fn verdict(mut self, sentence: impl Into<String>) -> Self {
        self.verdict = Some(sentence.into());
        self
    }

    /// Start a section.
    #[must_use]
    pub fn section(mut self, heading: impl AsRef<str>) -> Self {
        self.body.push(html! { h2 { (heading.as_ref()) } });
        self
    }

    /// A paragraph of plain text; what stands between backticks is set as code, here and in captions.
    #[must_use]
    pub fn paragraph(mut self, text: impl AsRef<str>) -> Self {
        self.body.push(html! { p { (words(text.as_ref())) } });
        self
    }

    /// One figure over the whole width.
    #[must_use]
    pub fn figure(mut self, figure: &impl Figure, caption: impl AsRef<str>) -> Self {
        self.body.push(figure_markup(figure, caption.as_ref()));
        self
    }

    /// Several figures side by side, as many in a row as the page holds.
    #[must_use]
    pub fn figures<C: AsRef<str>>(
        mut self,
        figures: impl IntoIterator<Item = (Box<dyn Figure>, C)>,
    ) -> Self {
        self.body.push(html! { div.grid {
            @for (figure, caption) in figures { (figure_markup(figure.as_ref(), caption.as_ref())) }
        } });
        self
    }

    /// A table.
    #[must_use]
    pub fn table(mut self, table: Table) -> Self {
        self.body.push(table.markup());
        self
    }

    /// Lines that open on a click: what only some readers want.
    #[must_use]
    pub fn details<T: AsRef<str>>(
        mut self,
        summary: impl AsRef<str>,
        lines: impl IntoIterator<Item = T>,
    ) -> Self {
        self.body.push(html! { details {
            summary { (summary.as_ref()) }
            @for line in lines { p { (words(line.as_ref())) } }
        } });
        self
    }

    /// The whole document.
    pub fn to_html(&self) -> String {
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    h1 { (self.title) }
                    @if let Some(verdict) = &self.verdict { p.verdict { (words(verdict)) } }
                    @for part in &self.body { (part) }
                }
            }
        }
        .into_string()
    }

    /// Write the document; an existing file is replaced whole or, on an error, left as it was.
    ///
    /// # Errors
    /// When the folder is not there or cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> io::Result<()> {
        let path = path.as_ref();
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        // As any file that a program writes: the person's umask decides who reads it. The default of a temporary file is nobody else.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = builder.tempfile_in(folder)?;
        file.write_all(self.to_html().as_bytes())?;
        file.persist(path).map_err(|error| error.error)?;
        Ok(())
    }
}

fn figure_markup(figure: &dyn Figure, caption: &str) -> Markup {
    html! { figure { div.scroll { (PreEscaped(figure.svg())) } figcaption { (words(caption)) } } }
}

/// Text in which pairs of backticks set code: sentences are shared with the terminal, where they are what readers know.
fn words(text: &str) -> Markup {
    let parts: Vec<&str> = text.split('`').collect();
    // One without its partner is meant as it is.
    if parts.len().is_multiple_of(2) {
        return html! { (text) };
    }
    html! { @for (i, part) in parts.into_iter().enumerate() {
        @if i.is_multiple_of(2) { (part) } @else { code { (part) } }
    } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backticks_set_code() {
        let html = Report::new("r").paragraph("`mean` and `a < b`; it`s").paragraph("run `x -y`.");
        let html = html.to_html();
        assert!(html.contains("run <code>x -y</code>."), "{html}");
        assert!(html.contains("`mean` and `a &lt; b`; it`s"), "{html}");
    }

    #[test]
    fn text_is_escaped() {
        let html = Report::new("a < b").verdict("x & y").paragraph("<script>").to_html();
        assert!(html.contains("a &lt; b") && html.contains("x &amp; y"));
        assert!(!html.contains("<script>"));
    }

    #[test]
    fn a_report_refers_to_nothing_outside_itself() {
        let plot =
            plot::LinePlot::new("t").series(plot::Series::line("s", vec![(0.0, 0.0), (1.0, 1.0)]));
        let html = Report::new("r").figure(&plot, "c").to_html();
        for outside in ["src=", "href=", "@import", "url("] {
            assert!(!html.contains(outside), "{outside}");
        }
    }

    #[test]
    fn figures_move_sideways_by_themselves_where_the_page_is_narrow() {
        let plot = plot::LinePlot::new("t");
        let html = Report::new("r").figure(&plot, "c").to_html();
        assert!(html.contains("<figure><div class=\"scroll\"><svg"), "{html}");
        assert!(html.contains("figure svg { min-width: 640px; }"));
    }

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("report.html");
        Report::new("old").write(&path).expect("written");
        assert!(Report::new("new").write(folder.path().join("missing/report.html")).is_err());
        assert!(std::fs::read_to_string(&path).expect("read").contains("old"));
        assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_a_report_as_they_may_read_any_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("temporary folder");
        let mode = |name: &str| {
            let meta = std::fs::metadata(folder.path().join(name)).expect("there");
            meta.permissions().mode()
        };
        std::fs::write(folder.path().join("any"), "").expect("written");
        Report::new("r").write(folder.path().join("report.html")).expect("written");
        assert_eq!(mode("report.html"), mode("any"));
    }

    #[test]
    fn numbers_are_recognised() {
        for cell in ["12", "-0.3 nm", "[1, 2]", "±4", "< 5"] {
            assert!(is_number(cell), "{cell}");
        }
        for cell in ["creep", "", "-", "n/a"] {
            assert!(!is_number(cell), "{cell}");
        }
    }
}
