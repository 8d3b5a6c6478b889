//! What every solid voxel hangs on, kept up from change to change.
//!
//! Every solid voxel has a parent among its neighbours (faces and edges), and parents lead to
//! ground. A cut leaves only the voxels whose parent it took to be re-hung; a neighbour serves when
//! its own line of parents reaches ground without them, else what hangs there is searched through
//! until one does. What finds none is loose. A re-hanging walks lines as long as the part is high;
//! the search is rare. So the verdict is exact, at the cost of the voxels that change.

use std::collections::{HashMap, VecDeque};

const NOBODY: u32 = u32::MAX;

pub(super) struct Standing {
    dims: [usize; 3],
    /// Layers that are ground.
    ground: Vec<bool>,
    /// The neighbour each solid voxel hangs on; itself on ground.
    parent: Vec<u32>,
    /// Marks of the search at hand.
    seen: Vec<u32>,
    search: u32,
}

impl Standing {
    /// Of an empty grid; `ground` tells which layers are ground.
    pub fn new(dims: [usize; 3], ground: Vec<bool>) -> Standing {
        let n = dims.iter().product();
        Standing { dims, ground, parent: vec![NOBODY; n], seen: vec![0; n], search: 0 }
    }

    /// Takes in voxels that have become solid; false when one of them is loose.
    pub fn added(&mut self, voxels: impl Iterator<Item = [usize; 3]>) -> bool {
        let new: Vec<[usize; 3]> =
            voxels.filter(|v| self.parent[self.index(*v)] == NOBODY).collect();
        self.search += 1;
        let mut open = VecDeque::new();
        for &v in &new {
            let i = self.index(v);
            self.seen[i] = self.search;
            let mut near = self.neighbours(v).map(|q| self.index(q));
            let host =
                if self.ground[v[2]] { Some(i) } else { near.find(|q| self.parent[*q] != NOBODY) };
            if let Some(host) = host {
                self.parent[i] = host as u32;
                open.push_back(v);
            }
        }
        while let Some(v) = open.pop_front() {
            for q in self.neighbours(v) {
                let i = self.index(q);
                if self.parent[i] == NOBODY && self.seen[i] == self.search {
                    self.parent[i] = self.index(v) as u32;
                    open.push_back(q);
                }
            }
        }
        new.iter().all(|v| self.parent[self.index(*v)] != NOBODY)
    }

    /// Takes in voxels that are solid no more; false when something is loose without them.
    pub fn removed(&mut self, voxels: impl Iterator<Item = [usize; 3]>) -> bool {
        let gone: Vec<[usize; 3]> =
            voxels.filter(|v| self.parent[self.index(*v)] != NOBODY).collect();
        gone.iter().for_each(|v| {
            let i = self.index(*v);
            self.parent[i] = NOBODY;
        });
        let mut orphans: Vec<usize> = Vec::new();
        for &v in &gone {
            let cut = self.index(v) as u32;
            let near = self.neighbours(v).map(|q| self.index(q));
            orphans.extend(near.filter(|q| self.parent[*q] == cut));
        }
        self.rehang(orphans)
    }

    /// Whether a voxel is solid, hence hangs on something.
    pub fn has(&self, v: [usize; 3]) -> bool {
        self.parent[self.index(v)] != NOBODY
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.dims[0] * (y + self.dims[1] * z)
    }

    fn voxel(&self, i: usize) -> [usize; 3] {
        let [nx, ny, _] = self.dims;
        [i % nx, i / nx % ny, i / nx / ny]
    }

    /// Face and edge neighbours inside the box, the lower ones first.
    pub fn neighbours(&self, v: [usize; 3]) -> impl Iterator<Item = [usize; 3]> + use<> {
        let dims = self.dims;
        (0..27usize).filter_map(move |i| {
            let o = [i % 3, i / 3 % 3, i / 9];
            let off_axes = o.iter().filter(|c| **c != 1).count();
            let mut q = [0; 3];
            for a in 0..3 {
                q[a] = (v[a] + o[a]).checked_sub(1).filter(|c| *c < dims[a])?;
            }
            (off_axes == 1 || off_axes == 2).then_some(q)
        })
    }

    /// Whether the line of parents from `i` ends on ground without meeting a voxel that hangs on
    /// nothing.
    fn stands(&self, mut i: usize) -> bool {
        loop {
            match self.parent[i] {
                NOBODY => return false,
                p if p as usize == i => return true,
                p => i = p as usize,
            }
        }
    }

    /// Finds new parents; false when something is loose.
    fn rehang(&mut self, mut orphans: Vec<usize>) -> bool {
        // An orphan is solid although it has no parent, which the search must know.
        let waiting: Vec<usize> = orphans.clone();
        orphans.iter().for_each(|o| self.parent[*o] = NOBODY);
        while !orphans.is_empty() {
            let before = orphans.len();
            let mut left = Vec::new();
            for &o in &orphans {
                let near = self.neighbours(self.voxel(o)).map(|q| self.index(q));
                match near.into_iter().find(|q| self.stands(*q)) {
                    Some(host) => self.parent[o] = host as u32,
                    None => left.push(o),
                }
            }
            orphans = left;
            if orphans.len() == before {
                if !self.search_ground(orphans[0], &waiting) {
                    return false;
                }
                let parent = &self.parent;
                orphans.retain(|o| parent[*o] == NOBODY);
            }
        }
        true
    }

    /// Searches all that is connected to `start` for a voxel that stands, and hangs the way to it
    /// there. Solid is what has a parent or waits for one.
    fn search_ground(&mut self, start: usize, waiting: &[usize]) -> bool {
        self.search += 1;
        self.seen[start] = self.search;
        let mut open = VecDeque::from([start]);
        let mut came_from = HashMap::new();
        while let Some(i) = open.pop_front() {
            for q in self.neighbours(self.voxel(i)) {
                let q = self.index(q);
                let solid = self.parent[q] != NOBODY || waiting.contains(&q);
                if self.seen[q] == self.search || !solid {
                    continue;
                }
                self.seen[q] = self.search;
                came_from.insert(q, i);
                if self.stands(q) {
                    let mut host = q;
                    while let Some(&next) = came_from.get(&host) {
                        self.parent[next] = host as u32;
                        host = next;
                    }
                    return true;
                }
                open.push_back(q);
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::bodies::Bodies;
    use crate::voxel::BitGrid;
    use proptest::prelude::*;

    /// Whether every body has a voxel in the lowest layer.
    fn stable(g: &BitGrid) -> bool {
        let bodies = Bodies::of(g);
        let mut held = vec![false; bodies.runs.len()];
        bodies.runs.iter().zip(&bodies.body).for_each(|(r, b)| held[*b] |= r.z == 0);
        bodies.body.iter().all(|b| held[*b])
    }

    proptest! {
        #[test]
        fn the_verdict_is_that_of_the_bodies(
            changes in proptest::collection::vec((any::<bool>(), any::<u64>(), any::<u64>()), 1..40),
        ) {
            let dims = [4, 4, 4];
            let mut state = BitGrid::new(dims);
            let mut standing = Standing::new(dims, vec![true, false, false, false]);
            for (adds, a, b) in changes {
                // Bits of both, so that changes are small.
                let bits = a & b & a.rotate_left(17);
                let region = BitGrid::from_fn(dims, |[x, y, z]| bits >> (x + 4 * (y + 4 * z)) & 1 == 1);
                let next = if adds { state.or(&region) } else { state.minus(&region) };
                let says = match adds {
                    true => standing.added(region.iter_ones()),
                    false => standing.removed(region.iter_ones()),
                };
                prop_assert_eq!(says, stable(&next));
                if !says {
                    break;
                }
                state = next;
            }
        }
    }
}
