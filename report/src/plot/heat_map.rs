//! A map of values over two sets of categories, each cell with its number.

use plotters::prelude::*;

use super::{Figure, draw, font};

/// Values over rows and columns, dark where large.
#[derive(Clone, Default)]
pub struct HeatMap {
    title: String,
    columns: Vec<String>,
    rows: Vec<String>,
    values: Vec<Vec<f64>>,
    unit: String,
}

impl HeatMap {
    /// An empty map.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// Column names, left to right.
    #[must_use]
    pub fn columns<T: Into<String>>(mut self, names: impl IntoIterator<Item = T>) -> Self {
        self.columns = names.into_iter().map(Into::into).collect();
        self
    }

    /// Row names, top to bottom.
    #[must_use]
    pub fn rows<T: Into<String>>(mut self, names: impl IntoIterator<Item = T>) -> Self {
        self.rows = names.into_iter().map(Into::into).collect();
        self
    }

    /// One list of values per row; NaN is drawn as an empty cell.
    #[must_use]
    pub fn values(mut self, values: Vec<Vec<f64>>) -> Self {
        self.values = values;
        self
    }

    /// Unit behind each number.
    #[must_use]
    pub fn unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = unit.into();
        self
    }
}

impl Figure for HeatMap {
    fn svg(&self) -> String {
        const LEFT: i32 = 150;
        const TOP: i32 = 64;
        const ROW: i32 = 34;
        let size = (720, (TOP + ROW * self.rows.len().max(1) as i32 + 12) as u32);
        let width = (size.0 as i32 - LEFT - 12) / self.columns.len().max(1) as i32;
        let largest = self
            .values
            .iter()
            .flatten()
            .filter(|v| v.is_finite())
            .fold(0.0_f64, |a, v| a.max(v.abs()));
        draw(size, |area| {
            use plotters::style::text_anchor::{HPos, Pos, VPos};
            let text = |error: DrawingAreaErrorKind<std::io::Error>| error.to_string();
            let at = |h, v| Pos::new(h, v);
            area.draw(&Text::new(
                self.title.clone(),
                (360, 6),
                font(17).pos(at(HPos::Center, VPos::Top)),
            ))
            .map_err(text)?;
            for (index, name) in self.columns.iter().enumerate() {
                let x = LEFT + width * index as i32 + width / 2;
                area.draw(&Text::new(
                    name.clone(),
                    (x, TOP - 8),
                    font(13).pos(at(HPos::Center, VPos::Bottom)),
                ))
                .map_err(text)?;
            }
            for (index, name) in self.rows.iter().enumerate() {
                let y = TOP + ROW * index as i32;
                let style = font(13).pos(at(HPos::Right, VPos::Center));
                area.draw(&Text::new(name.clone(), (LEFT - 10, y + ROW / 2), style))
                    .map_err(text)?;
                for column in 0..self.columns.len() {
                    let value = self.values.get(index).and_then(|row| row.get(column)).copied();
                    let Some(value) = value.filter(|v| v.is_finite()) else { continue };
                    let depth = if largest > 0.0 { (value.abs() / largest).min(1.0) } else { 0.0 };
                    let x = LEFT + width * column as i32;
                    let corners = [(x + 1, y + 1), (x + width - 1, y + ROW - 1)];
                    area.draw(&Rectangle::new(corners, shade(depth).filled())).map_err(text)?;
                    let ink = if depth > 0.55 { WHITE } else { BLACK };
                    let number = if value.abs() >= 10.0 {
                        format!("{value:.0}")
                    } else {
                        format!("{value:.1}")
                    };
                    let style = font(13).color(&ink).pos(at(HPos::Center, VPos::Center));
                    let place = (x + width / 2, y + ROW / 2);
                    area.draw(&Text::new(format!("{number}{}", self.unit), place, style))
                        .map_err(text)?;
                }
            }
            Ok(())
        })
    }
}

/// White to the palette's blue.
fn shade(depth: f64) -> RGBColor {
    let mix = |full: f64| (245.0 + (full - 245.0) * depth).round() as u8;
    RGBColor(mix(0.0), mix(90.0), mix(160.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_carry_their_numbers_and_missing_ones_stay_empty() {
        let map = HeatMap::new("share")
            .columns(["drive", "piezo"])
            .rows(["axis 1"])
            .values(vec![vec![12.0, f64::NAN]])
            .unit(" %");
        let svg = map.svg();
        assert!(svg.contains("12 %") && !svg.contains("NaN"));
        assert!(HeatMap::new("empty").svg().contains("<svg"));
    }
}
