//! Hand-made plans that break one rule each, and a plain reading of the rules to compare with.

mod end;
mod fidelity;
mod reach;
mod reference;
mod rules;
mod world;
