//! Stability of every state to come, exactly, from one number a voxel.
//!
//! The bottleneck height b(v) is the least h such that v is connected (Def. 2.1) to the base layer
//! through voxels no higher than layer h. Once everything above layer h is eroded, v is connected
//! to the base if and only if b(v) ≤ h. Accretion can only lower b, and only where the new voxel
//! opens a lower way; erosion of the top layer K changes no b below K. Kept by a relaxation like
//! Dijkstra's, so a voxel is touched again only when its own value falls.

use super::workpiece::{Cell, Workpiece};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Bottleneck of what is not connected to the base, or not solid.
const NEVER: u16 = u16::MAX;

#[derive(Clone)]
pub(super) struct Bottleneck {
    heights: Vec<u16>,
}

impl Bottleneck {
    /// Of a whole state, in buckets of rising height.
    pub fn new(w: &Workpiece) -> Bottleneck {
        let mut b = Bottleneck { heights: vec![NEVER; w.len()] };
        let layers = w.dims()[2].max(1) as usize;
        let mut buckets: Vec<Vec<Cell>> = vec![Vec::new(); layers];
        for cell in w.layer(0) {
            b.heights[cell as usize] = 0;
            buckets[0].push(cell);
        }
        let offsets = w.offsets();
        for height in 0..layers {
            while let Some(cell) = buckets[height].pop() {
                for o in offsets {
                    let n = (cell as i32 + o) as Cell;
                    if b.heights[n as usize] == NEVER && w.solid(n) {
                        let h = height.max(w.height(n) as usize);
                        b.heights[n as usize] = h as u16;
                        buckets[h].push(n);
                    }
                }
            }
            buckets[height] = Vec::new();
        }
        b
    }

    /// b(v); none for what is not connected to the base.
    pub fn height(&self, cell: Cell) -> Option<u16> {
        Some(self.heights[cell as usize]).filter(|h| *h != NEVER)
    }

    /// Whether a solid cell is connected to the base at all.
    pub fn is_connected(&self, cell: Cell) -> bool {
        self.heights[cell as usize] != NEVER
    }

    /// Whether the cell is solid and stays connected when layer `top` is gone.
    pub fn grounded(&self, cell: Cell, top: i32) -> bool {
        i32::from(self.heights[cell as usize]) < top
    }

    /// Takes in cells that have just become solid.
    pub fn accreted(&mut self, w: &Workpiece, cells: &[Cell]) {
        let mut heap = BinaryHeap::new();
        for &cell in cells {
            let z = w.height(cell) as u16;
            let near = w.neighbours(cell).map(|n| self.heights[n as usize]);
            let least = near.into_iter().min().unwrap_or(NEVER);
            if z == 0 || least != NEVER {
                let h = if z == 0 { 0 } else { least.max(z) };
                self.heights[cell as usize] = h;
                heap.push(Reverse((h, cell)));
            }
        }
        let offsets = w.offsets();
        while let Some(Reverse((h, cell))) = heap.pop() {
            if self.heights[cell as usize] != h {
                continue;
            }
            for o in offsets {
                let n = (cell as i32 + o) as Cell;
                if w.solid(n) && self.heights[n as usize] > h {
                    let lower = h.max(w.height(n) as u16);
                    if lower < self.heights[n as usize] {
                        self.heights[n as usize] = lower;
                        heap.push(Reverse((lower, n)));
                    }
                }
            }
        }
    }

    /// Forgets an eroded cell.
    pub fn eroded(&mut self, cell: Cell) {
        self.heights[cell as usize] = NEVER;
    }
}
