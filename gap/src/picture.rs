//! The report that a person reads.

use report::Report;

use crate::diagnose::Findings;

/// Draw the findings.
pub fn report(findings: &Findings) -> Report {
    Report::new(&format!("Diagnosis of {}", findings.nominal.name))
}
