//! Ways of the tip from one chain to the next.
//!
//! Method: through what is cut where the next chain is near; back along a short chain to where it began; over what stands
//! by a millimetre where that is sooner than over the safe height; else over the safe height. Guarantees: a way over what
//! stands is clear of what must stay and of what is still to cut at every place that is looked at; rapids go only at the
//! safe height or straight up. Not guaranteed: the soonest way.

use super::super::image::Cell;
use super::super::moves::MoveKind;
use super::super::process::ENTRY_MM;
use super::Stage;
use crate::base::{DVec2, DVec3};

/// Chains farther apart than this many stepovers are not linked through what is cut.
const FAR_STEPOVERS: f64 = 4.0;

/// Places of a way that are looked at, in each cell: of spires 62° steep 0.012 mm goes unseen on cells of 0.5 mm.
const LOOKS: f64 = 4.0;

impl Stage<'_> {
    /// Goes over the first cell of the next chain, no lower than what lies on the way, when it is
    /// near and the way is free; false when a retract is needed. From what was cut at another level (`anew`)
    /// the way goes through no more than a level of what may stand beside it.
    pub(super) fn link(
        &mut self,
        to: Cell,
        stepover: f64,
        z: &dyn Fn(usize) -> f32,
        anew: bool,
    ) -> bool {
        let Some((from, z0)) = self.at else { return false };
        let d = [to[0] as f64 - from[0] as f64, to[1] as f64 - from[1] as f64];
        let gap = d[0].hypot(d[1]);
        if gap > FAR_STEPOVERS * stepover.max(1.0) {
            return false;
        }
        let n = (LOOKS * gap).ceil().max(1.0);
        let (start, end) = (self.lattice.uv(from) + self.aside, self.lattice.uv(to));
        let mut over = z0;
        for i in 0..=n as usize {
            let t = i as f64 / n;
            let c = [
                (from[0] as f64 + t * d[0]).round() as usize,
                (from[1] as f64 + t * d[1]).round() as usize,
            ];
            let at = self.lattice.index(c);
            over = over.max(f64::from(z(at)));
            if anew {
                over = over.max(f64::from(self.stock.over(at)) - self.process.step_down);
            }
            // The way crosses the lattice between its cells, where a ridge may be higher.
            if let Some(meshes) = &self.meshes {
                over = over.max(meshes.lowest(start.lerp(end, t), &self.fine));
            }
        }
        // Infinite where no region is under the edge: the way is not known to be clear.
        if over > z0.max(f64::from(z(self.lattice.index(to)))) + self.process.step_down {
            return false;
        }
        self.push(MoveKind::Cut, from, over, self.process.feed);
        self.push(MoveKind::Cut, to, over, self.process.feed);
        true
    }

    /// Back along the last chain to where it began, when that is near a cell and sooner than over the safe height.
    pub(super) fn go_back(&mut self, to: Cell, stepover: f64) -> bool {
        let (Some(began), Some((_, z))) = (self.chain, self.at) else { return false };
        let plane = self.lattice.plane;
        let tips: Vec<DVec3> = self.moves[began..]
            .iter()
            .map(|m| plane.across(m.tip).extend(plane.height(m.tip)))
            .collect();
        let Some(cell) = self.lattice.cell(tips[0].truncate()) else { return false };
        let gap = [0, 1].map(|a| cell[a] as f64 - to[a] as f64);
        let length: f64 = tips.windows(2).map(|w| w[0].distance(w[1])).sum();
        let over = self.over_safe_min(z, tips[0].z) + ENTRY_MM / self.process.plunge_feed;
        if gap[0].hypot(gap[1]) > FAR_STEPOVERS * stepover.max(1.0)
            || length / self.process.feed > over
        {
            return false;
        }
        self.chain = None;
        for tip in tips.into_iter().rev().skip(1) {
            if let Some(cell) = self.lattice.cell(tip.truncate()) {
                let aside = tip.truncate() - self.lattice.uv(cell);
                self.go(MoveKind::Cut, cell, aside, tip.z, self.process.feed);
            }
        }
        true
    }

    /// Minutes from one height up to the safe one and down to another.
    fn over_safe_min(&self, from: f64, to: f64) -> f64 {
        let rapid = self.work.job.machine.control.rapid_mm_min;
        (self.safe - from) / rapid + (self.safe - to) / self.process.approach_feed
    }

    /// Over what stands on the way, or over the safe height where that is sooner, to a place beside a cell, and down to
    /// a height `near` over material.
    pub(super) fn enter(&mut self, (cell, aside): (Cell, DVec2), near: f64) {
        let feed = self.process.approach_feed;
        match (self.hop((cell, aside), near), self.at) {
            (Some(over), Some((from, _))) => {
                self.go(MoveKind::Approach, from, self.aside, over, feed);
                self.go(MoveKind::Approach, cell, aside, over, feed);
            }
            _ => {
                self.retract();
                self.go(MoveKind::Rapid, cell, aside, self.safe, 0.0);
            }
        }
        if self.at.is_some_and(|(_, z)| near < z) {
            self.go(MoveKind::Approach, cell, aside, near, feed);
        }
    }

    /// The height at which the tip goes straight to a place beside a cell, clear of what stands and of what is still to
    /// cut; none where no such way is known or the one over the safe height is sooner.
    fn hop(&self, (to, aside): (Cell, DVec2), near: f64) -> Option<f64> {
        let (from, z) = self.at?;
        let l = &self.lattice;
        let (start, end) = (l.uv(from) + self.aside, l.uv(to) + aside);
        let gap = start.distance(end);
        let sooner = |over: f64| {
            let hop = (over - z) + gap + (over - near);
            let across = gap / self.work.job.machine.control.rapid_mm_min;
            hop / self.process.approach_feed < self.over_safe_min(z, near) + across
        };
        let n = (LOOKS * gap / l.s).ceil().max(1.0);
        let (mut over, mut last) = (z.max(near), None);
        for i in 0..=n as usize {
            let at = start.lerp(end, i as f64 / n);
            let c = l.cell(at)?;
            // Beside the region the tool has no business but at the safe height.
            if !self.top.data[l.index(c)].is_finite() {
                return None;
            }
            let around = self.cells_around(at).map(|c| self.fine.tips.data[l.index(c)]);
            let mut stands = around.fold(f32::NEG_INFINITY, f32::max);
            if last != Some(c) {
                stands = stands.max(self.stock.over(l.index(c)));
                last = Some(c);
            }
            over = over.max(f64::from(stands) + ENTRY_MM);
            if over >= self.safe || !sooner(over) {
                return None;
            }
        }
        // Between the cells something may be higher.
        let mut on = None;
        let mut is_free = |i: usize| {
            let at = start.lerp(end, i as f64 / n);
            self.meshes.as_ref().is_none_or(|m| m.is_free(at, over, &self.fine, &mut on))
        };
        (0..=n as usize).all(&mut is_free).then_some(over)
    }

    pub(super) fn retract(&mut self) {
        if let Some((c, z)) = self.at
            && z < self.safe
        {
            self.push(MoveKind::Rapid, c, self.safe, 0.0);
        }
        (self.at, self.chain) = (None, None);
    }

    /// The cells between whose middles a place lies.
    pub(super) fn cells_around(&self, at: DVec2) -> impl Iterator<Item = Cell> + use<> {
        let l = &self.lattice;
        let g = (at - l.origin) / l.s;
        let span =
            |x: f64, n: usize| x.floor().max(0.0) as usize..(x.ceil().max(0.0) as usize + 1).min(n);
        let (columns, rows) = (span(g.x, l.n[0]), span(g.y, l.n[1]));
        rows.flat_map(move |j| columns.clone().map(move |i| [i, j]))
    }
}
