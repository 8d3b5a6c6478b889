//! Domain-free search engines, tested on toy problems with known optima.
//!
//! Guarantees: [`set_cover`] returns a proven optimum of the weighted set-cover problem;
//! [`mcts::search`] the same answer for the same seed. Not guaranteed: anything about ties beyond
//! their being broken the same way every time.

mod cover;
pub mod mcts;

pub use cover::{CoverError, WeightedSet, set_cover};
