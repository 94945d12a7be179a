//! A session, ready to be compared with simulations of it. Recordings go in, whitened residuals of any rig come out.
//!
//! | file | what it does |
//! | --- | --- |
//! | [`intake`] | lays recordings on their clocks |
//! | `period` | whether a drive repeats as it says |
//! | `wild` | readings that no motion makes |
//! | `past`, `memory` | what the stacks went through before a recording begins, and what of that nobody can know |
//! | [`lead_in`] | what a single recording tells of that before it is scored |
//! | [`floor`] | noise, measured |
//! | [`pyramid`], `spectra`, `coherent` | residuals by bands; lines and resonances in their spectra; a line's frequency over the whole session |
//! | [`split`] | which recordings are fitted, and which only score |
//! | `motions` | simulates, and keeps motions that will be asked for again |
//! | `work` | how much was simulated, and when that is enough |
//! | `channel` | one measured quantity of one axis in one recording |
//! | [`scene`] | whitened residuals: all of the above together |
//! | `dead` | axes that do not move at all where they are driven |
//! | [`energy`] | size of a gap in nanometres, with intervals |

mod channel;
pub(crate) mod coherent;
pub(crate) mod dead;
pub mod energy;
pub mod floor;
pub mod intake;
pub mod lead_in;
pub(crate) mod memory;
pub(crate) mod motions;
pub(crate) mod past;
mod period;
pub mod pyramid;
pub mod scene;
pub(crate) mod spectra;
pub mod split;
mod wild;
pub(crate) mod work;
