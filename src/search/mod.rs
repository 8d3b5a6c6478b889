//! Domain-free search engines, tested on toy problems with known optima.
//!
//! Guarantees: [`set_cover`] returns a proven optimum of the weighted set-cover problem;
//! [`ida()`] a cheapest path when its estimate never exceeds what is left; [`mcts::search`] the same
//! answer for the same seed. Not guaranteed: anything about ties beyond their being broken the same
//! way every time.

mod cover;
mod ida;
#[cfg(test)]
mod ida_tests;
pub mod mcts;

pub use cover::{CoverError, WeightedSet, set_cover};
pub use ida::{
    Ending, Found, IdaOptions, Made, Seen, Status, Successor, Successors, TIE, World, ida,
};
