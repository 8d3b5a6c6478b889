//! What a person looks at: the figures of a plan and a self-contained page about it.
//!
//! Method: [`summarise`] counts voxels of the states that the steps define; [`page`] fills one
//! HTML template, with a drawing per step made from the voxels themselves.
//!
//! Guarantees: the page needs no network and no other file; the same plan gives the same bytes,
//! so it holds no measured time. Not guaranteed: that a drawing shows every voxel of a region;
//! it shows the side that shows most of it.

mod draw;
mod page;
mod place;
mod summary;

pub use draw::{Drawing, draw_step};
pub use page::{mm3, page};
pub use place::in_words;
pub use summary::{PlannerFigures, RuleLine, residual_location, rule_lines, summarise};
