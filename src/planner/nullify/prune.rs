//! Supports that turned out to be needless are left out of the sequence.
//!
//! A support is built for what is needy at its moment; supports of later rounds often carry or
//! hold the same voxels. Leaving one out only opens ways for the cutter, so two things are to be
//! proved: each voxel that it carried has another carrier when it is deposited, and nothing is
//! loose without it in any state in which it stands. For the second its solid neighbours are
//! searched from until all of them have met each other or material that stands without any
//! support; what they met by lasts until a voxel of it goes, and only then is searched again.
//!
//! Guarantees: what is left is a valid sequence whenever the whole was. Not guaranteed: that no
//! needless support is left; a search that grows too long keeps its support.
//!
//! States count the deeds of nullification: state t is what stands after the first t of them.

use super::bottleneck::Bottleneck;
use super::layer::Undoing;
use super::workpiece::{Cell, Workpiece};

/// Sweeps over all supports at most.
const SWEEPS: usize = 3;

/// Cells that one search may visit. Fewer, and long ways round are not found; more, and supports
/// that are needed cost time for nothing.
const MOST_VISITS: usize = 120;

const NEVER: u32 = u32::MAX;

/// The deeds without the needless accretions and the erosions that undo them, in order. `w` is the
/// state after all of them, `bare` the bottleneck heights of the state before.
pub(super) fn pruned(
    w: &Workpiece,
    bare: &Bottleneck,
    deeds: &[(Cell, Undoing)],
) -> Vec<(Cell, Undoing)> {
    let mut lives = Lives::of(w, bare, deeds);
    let mut search = Search { place: vec![0; w.len()], nodes: Vec::new() };
    let accreted = |d: &&(Cell, Undoing)| matches!(d.1, Undoing::Accreted(_));
    let mut supports: Vec<Cell> = deeds.iter().filter(accreted).map(|d| d.0).collect();
    // From the top down: what only carried a needless one is needless in the same sweep.
    supports.sort_unstable_by(|a, b| b.cmp(a));
    for _ in 0..SWEEPS {
        let before = supports.len();
        supports.retain(|&s| {
            let needless = lives.spares_carrier(w, s) && search.spares(w, &lives, s);
            if needless {
                lives.born[s as usize] = NEVER;
                lives.gone[s as usize] = NEVER;
            }
            !needless
        });
        if supports.len() == before {
            break;
        }
    }
    deeds.iter().filter(|(c, _)| lives.born[*c as usize] != NEVER).copied().collect()
}

/// When each cell is solid.
struct Lives<'a> {
    /// The first state, and one past the last.
    born: Vec<u32>,
    gone: Vec<u32>,
    /// The first state in which something of a layer is eroded.
    begun: Vec<u32>,
    bare: &'a Bottleneck,
}

impl<'a> Lives<'a> {
    fn of(w: &Workpiece, bare: &'a Bottleneck, deeds: &[(Cell, Undoing)]) -> Lives<'a> {
        let layers = w.dims()[2] as usize;
        let mut lives = Lives {
            born: vec![NEVER; w.len()],
            gone: vec![NEVER; w.len()],
            begun: vec![NEVER; layers],
            bare,
        };
        for (cell, born) in lives.born.iter_mut().enumerate() {
            if w.solid(cell as Cell) {
                *born = 0;
            }
        }
        for (t, (cell, undoing)) in deeds.iter().enumerate().rev() {
            let (i, after) = (*cell as usize, t as u32 + 1);
            match undoing {
                Undoing::Eroded => {
                    lives.gone[i] = after;
                    lives.born[i] = 0;
                    lives.begun[w.height(*cell) as usize] = after;
                }
                Undoing::Accreted(_) => lives.born[i] = after,
            }
        }
        lives
    }

    fn solid(&self, cell: Cell, state: u32) -> bool {
        self.born[cell as usize] <= state && state < self.gone[cell as usize]
    }

    /// One past the last state in which a solid cell surely stands without any support.
    fn stands_until(&self, cell: Cell) -> u32 {
        let height = self.bare.height(cell).map(usize::from);
        height.and_then(|h| self.begun.get(h)).copied().unwrap_or(0)
    }

    /// Whether each voxel deposited on `s` has another carrier at that moment.
    fn spares_carrier(&self, w: &Workpiece, s: Cell) -> bool {
        w.carried_by(s).into_iter().all(|u| {
            let state = self.gone[u as usize];
            state == NEVER
                || !self.solid(s, state)
                || w.carriers(u).into_iter().any(|c| c != s && self.solid(c, state))
        })
    }
}

struct Node {
    cell: Cell,
    /// The source it was reached from.
    source: usize,
    /// The first state in which a cell on the way from the source is gone.
    lasts: u32,
}

struct Search {
    /// Place of a cell in `nodes`, plus one; 0 for cells not visited.
    place: Vec<u32>,
    nodes: Vec<Node>,
}

/// Which sources have met; the last stands for the ground.
struct Meetings {
    host: [usize; 19],
    parties: usize,
}

const GROUND: usize = 18;

impl Meetings {
    fn root(&self, mut i: usize) -> usize {
        while self.host[i] != i {
            i = self.host[i];
        }
        i
    }

    /// Whether two that had not met meet now.
    fn meet(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.host[a.min(b)] = a.max(b);
        self.parties -= usize::from(a != b);
        a != b
    }
}

impl Search {
    /// Whether nothing is loose without `s` in any state in which it stands.
    fn spares(&mut self, w: &Workpiece, lives: &Lives, s: Cell) -> bool {
        let until = lives.gone[s as usize];
        let mut state = lives.born[s as usize];
        let near = w.neighbours(s);
        while state < until {
            let lasts = self.hold(w, lives, s, state);
            self.nodes.drain(..).for_each(|n| self.place[n.cell as usize] = 0);
            let Some(lasts) = lasts else { return false };
            let born = near.map(|n| lives.born[n as usize]);
            let next = born.into_iter().filter(|b| *b > state).min().unwrap_or(NEVER);
            state = next.min(lasts);
        }
        true
    }

    /// The state until which the neighbours of `s` surely hang together, or on the ground, without
    /// it; none when they are not found to in this state.
    fn hold(&mut self, w: &Workpiece, lives: &Lives, s: Cell, state: u32) -> Option<u32> {
        let mut meetings = Meetings { host: std::array::from_fn(|i| i), parties: 0 };
        let mut lasts = NEVER;
        for (source, n) in w.neighbours(s).into_iter().enumerate() {
            if lives.solid(n, state) {
                meetings.parties += 1;
                self.nodes.push(Node { cell: n, source, lasts: lives.gone[n as usize] });
                self.place[n as usize] = self.nodes.len() as u32;
            }
        }
        // What stands on the base by itself holds up its neighbours; they need the ground then.
        let mut grounded = w.height(s) == 0;
        meetings.parties += usize::from(grounded);
        let mut next = 0;
        while meetings.parties > 1 {
            let Node { cell, source, lasts: so_far } = *self.nodes.get(next)?;
            next += 1;
            let stands = if w.height(cell) == 0 { NEVER } else { lives.stands_until(cell) };
            if stands > state {
                meetings.parties += usize::from(!std::mem::replace(&mut grounded, true));
                if meetings.meet(source, GROUND) {
                    lasts = lasts.min(so_far).min(stands);
                }
                // Beyond there is nothing but what stands as well.
                continue;
            }
            for n in w.neighbours(cell) {
                match (self.place[n as usize] as usize).checked_sub(1) {
                    Some(other) => {
                        let other = &self.nodes[other];
                        if meetings.meet(source, other.source) {
                            lasts = lasts.min(so_far).min(other.lasts);
                        }
                    }
                    None if n != s && lives.solid(n, state) => {
                        let lasts = so_far.min(lives.gone[n as usize]);
                        self.nodes.push(Node { cell: n, source, lasts });
                        self.place[n as usize] = self.nodes.len() as u32;
                    }
                    None => {}
                }
            }
            if self.nodes.len() > MOST_VISITS {
                return None;
            }
        }
        Some(lasts)
    }
}
