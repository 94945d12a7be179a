//! Wall-clock time for file names and the log, in UTC: this program reads no time zones.

use std::time::{SystemTime, UNIX_EPOCH};

/// Year, month, day, seconds of the day (days to date: H. Hinnant, "chrono-compatible low-level date algorithms", civil_from_days).
fn utc(at: SystemTime) -> (i64, i64, i64, i64) {
    let seconds = at.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()) as i64;
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let day = doy - (153 * mp + 2) / 5 + 1;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    (yoe + era * 400 + i64::from(month <= 2), month, day, rest)
}

/// `2026-11-21-043000`.
pub fn stamp(at: SystemTime) -> String {
    let (year, month, day, rest) = utc(at);
    let (h, m, s) = (rest / 3600, rest % 3600 / 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02}-{h:02}{m:02}{s:02}")
}

/// `04:30:00`.
pub fn time_of_day(at: SystemTime) -> String {
    let rest = utc(at).3;
    format!("{:02}:{:02}:{:02}", rest / 3600, rest % 3600 / 60, rest % 60)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn known_dates() {
        let at = |s: u64| UNIX_EPOCH + Duration::from_secs(s);
        assert_eq!(stamp(at(0)), "1970-01-01-000000");
        assert_eq!(stamp(at(951_782_400)), "2000-02-29-000000");
        assert_eq!(stamp(at(1_735_689_599)), "2024-12-31-235959");
        assert_eq!(time_of_day(at(1_735_689_599)), "23:59:59");
    }
}
