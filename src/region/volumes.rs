use crate::machine::{Holding, HoldingMode};
use crate::plan_rules::Held;
use crate::voxel::{BitGrid, Frame};
