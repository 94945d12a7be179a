//! Recordings with withheld effects, made by an integrator and effect models of their own.
//!
//! A tool that finds what is missing from a model must not be tested on recordings made by its own model: it would be
//! asked to recognise its own formulas. This crate shares no physics with the simulator under test. It has another
//! integrator, other forms of every effect of the contract ([`effects`]), faults that no catalogue has ([`faults`]), the
//! usual probe session and sessions of anything ([`excitation`]), and judging recordings that the diagnosis never sees.
//! [`case`] draws labelled cases from a seed; [`score`] compares answers with the key.

pub mod case;
pub mod effects;
pub mod excitation;
pub mod faults;
pub mod forms;
pub mod hysteresis;
pub mod rig;
pub mod score;
pub mod simulate;
pub mod world;
