//! What may be said of a model that was found: named, doubted, or taken back.
//!
//! | file | what it asks |
//! | --- | --- |
//! | [`accept`] | is there a gap, and does a model close enough of it to be named? |
//! | [`ambiguity`] | what else could it be, and which experiment would tell? |
//! | `monitors` | do the amplifier monitors speak against it? |
//! | `strangers` | is there something outside the catalogue that does better? |
//! | `steady` | is a time constant the same at all times? |
//! | `slow` | do causes account for slow motion, if not for all of it? |
//! | `causes` | what each cause closes, with parameters and intervals |

pub mod accept;
pub mod ambiguity;
pub(crate) mod causes;
pub(crate) mod monitors;
pub(crate) mod slow;
pub(crate) mod steady;
pub(crate) mod strangers;
