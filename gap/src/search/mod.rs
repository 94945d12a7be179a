//! Which effects: a forward search over fitted models, with second thoughts.
//!
//! | step | files |
//! | --- | --- |
//! | what each effect of the catalogue promises, by sensitivities | [`screen`], `direction` |
//! | the most promising ones alone, on all axes and on each one | [`select`], `each_axis` |
//! | one more effect beside the best, up to three | `widen`, `compose`, `joint` |
//! | where a fit starts that does not get there by itself | `resonance`, `alike`, `threshold`, `variety`, `further_mode`, `wander`, `pairs` |
//! | what is not worth fitting to the end, and what is worth an effect more | `few`, `worth` |
//! | other effects in the place of those chosen, fewer, none where they do nothing | `swap`, `trade`, `fewer`, `prune` |
//! | loops of any law | `loops`, `laws`, `loop_beside` |
//! | what all axes have alike | `beside_alike`, `last_axis`, `hidden` |
//! | the whole of it, checked on recordings held out | `found`, `elsewhere` |

mod alike;
mod beside_alike;
mod compose;
mod direction;
mod each_axis;
mod elsewhere;
mod few;
mod fewer;
pub(crate) mod found;
mod further_mode;
pub(crate) mod hidden;
mod joint;
pub(crate) mod last_axis;
mod laws;
mod loop_beside;
pub(crate) mod loops;
mod pairs;
mod prune;
mod resonance;
mod ripple;
pub mod screen;
pub mod select;
mod swap;
mod threshold;
mod trade;
mod variety;
pub(crate) mod wander;
mod widen;
pub(crate) mod worth;
