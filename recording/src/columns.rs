//! Column names of a recording, and how a table of named columns becomes a [`Recording`].
//!
//! Both file formats end here, so that they accept and refuse the same things.

use std::path::Path;

use crate::{Error, Meta, Recording, Result};

/// Highest axis number that is read; columns of higher ones are unknown columns.
pub const MAX_AXES: usize = 64;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Column {
    Tick,
    Flags,
    Drive(usize),
    Monitor(usize),
    Position(usize),
    Reference(usize),
}

/// Makes a column of an axis.
pub(crate) type OfAxis = fn(usize) -> Column;

impl Column {
    /// `None` for a column that is not ours.
    pub(crate) fn parse(name: &str) -> Option<Self> {
        match name {
            "tick" => return Some(Self::Tick),
            "flags" => return Some(Self::Flags),
            _ => {}
        }
        let (kind, number) = name.rsplit_once('_')?;
        if number.starts_with('0') || !number.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let axis = number.parse::<usize>().ok().filter(|axis| (1..=MAX_AXES).contains(axis))? - 1;
        match kind {
            "drive_v" => Some(Self::Drive(axis)),
            "monitor_v" => Some(Self::Monitor(axis)),
            "position_um" => Some(Self::Position(axis)),
            "reference_um" => Some(Self::Reference(axis)),
            _ => None,
        }
    }

    pub(crate) fn name(self) -> String {
        match self {
            Self::Tick => "tick".into(),
            Self::Flags => "flags".into(),
            Self::Drive(axis) => format!("drive_v_{}", axis + 1),
            Self::Monitor(axis) => format!("monitor_v_{}", axis + 1),
            Self::Position(axis) => format!("position_um_{}", axis + 1),
            Self::Reference(axis) => format!("reference_um_{}", axis + 1),
        }
    }
}

/// Columns as they were found, before they are known to be a recording.
#[derive(Default)]
pub(crate) struct Table {
    pub(crate) tick: Option<Vec<u64>>,
    pub(crate) flags: Option<Vec<u32>>,
    drive: Vec<Option<Vec<f32>>>,
    monitor: Vec<Option<Vec<f32>>>,
    position: Vec<Option<Vec<f32>>>,
    reference: Vec<Option<Vec<f32>>>,
}

impl Table {
    pub(crate) fn set(&mut self, column: Column, values: Vec<f32>) {
        let (group, axis) = match column {
            Column::Tick | Column::Flags => return,
            Column::Drive(axis) => (&mut self.drive, axis),
            Column::Monitor(axis) => (&mut self.monitor, axis),
            Column::Position(axis) => (&mut self.position, axis),
            Column::Reference(axis) => (&mut self.reference, axis),
        };
        if group.len() <= axis {
            group.resize(axis + 1, None);
        }
        group[axis] = Some(values);
    }

    /// Checks that the columns make a recording. An axis may be absent as a whole; one of its two required columns may not.
    pub(crate) fn into_recording(mut self, meta: Meta, path: &Path) -> Result<Recording> {
        let missing = |column: Column, why: &str| {
            Err(Error::invalid(path, format!("column `{}` is missing{why}", column.name())))
        };
        let Some(tick) = self.tick else {
            return missing(Column::Tick, "");
        };
        let axes = [&self.drive, &self.monitor, &self.position, &self.reference]
            .iter()
            .map(|group| group.len())
            .max()
            .unwrap_or(0);
        for group in [&mut self.drive, &mut self.monitor, &mut self.position, &mut self.reference] {
            group.resize(axes, None);
        }
        let free_return = meta.initial_position_um.is_some();
        for axis in 0..axes {
            if self.position[axis].is_some() && self.drive[axis].is_none() && !free_return {
                return missing(
                    Column::Drive(axis),
                    &format!(" (axis {} has a position)", axis + 1),
                );
            }
            if self.drive[axis].is_some() && self.position[axis].is_none() {
                return missing(
                    Column::Position(axis),
                    &format!(" (axis {} has a drive)", axis + 1),
                );
            }
        }
        if self.position.iter().all(Option::is_none) {
            return missing(Column::Position(0), "");
        }
        let rows = tick.len();
        let recording = Recording {
            meta,
            tick,
            drive_v: self.drive.into_iter().map(|c| c.unwrap_or_else(|| vec![0.0; rows])).collect(),
            monitor_v: self.monitor,
            position_um: self.position,
            reference_um: self.reference,
            flags: self.flags,
        };
        recording.check(path)?;
        Ok(recording)
    }
}

impl Recording {
    /// The real-valued columns that the recording holds, in the order of the contract.
    pub(crate) fn real_columns(&self) -> Vec<(Column, &[f32])> {
        let mut columns = Vec::new();
        for (axis, values) in self.drive_v.iter().enumerate() {
            // An absent axis stays absent: its drive is only filled in when read.
            if self.position_um[axis].is_none() && values.iter().all(|volts| *volts == 0.0) {
                continue;
            }
            columns.push((Column::Drive(axis), values.as_slice()));
        }
        type Group<'a> = (OfAxis, &'a [Option<Vec<f32>>]);
        let optional: [Group; 3] = [
            (Column::Monitor, &self.monitor_v),
            (Column::Position, &self.position_um),
            (Column::Reference, &self.reference_um),
        ];
        for (name, group) in optional {
            for (axis, values) in group.iter().enumerate() {
                if let Some(values) = values {
                    columns.push((name(axis), values.as_slice()));
                }
            }
        }
        columns
    }
}
