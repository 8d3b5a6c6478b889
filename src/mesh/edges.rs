//! Which triangles share which edges, and disjoint sets with a relative orientation.

use super::TriMesh;

/// One triangle's use of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Use {
    low: u32,
    high: u32,
    pub triangle: u32,
    /// Traversed from the lower-numbered vertex to the higher.
    pub forward: bool,
}

/// The edges of a mesh with their uses, in the order of their vertices.
pub(super) struct Shared(Vec<Use>);

impl Shared {
    /// Triangles that name a vertex twice bound nothing and are left out.
    pub fn of(mesh: &TriMesh) -> Shared {
        let mut uses = Vec::with_capacity(mesh.triangles().len() * 3);
        for (triangle, [a, b, c]) in (0u32..).zip(mesh.triangles().iter().copied()) {
            if a == b || b == c || c == a {
                continue;
            }
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let (low, high) = (from.min(to), from.max(to));
                uses.push(Use { low, high, triangle, forward: from < to });
            }
        }
        uses.sort_unstable();
        Shared(uses)
    }

    /// Each edge's vertices and uses.
    pub fn edges(&self) -> impl Iterator<Item = ([u32; 2], &[Use])> {
        let same = |a: &Use, b: &Use| (a.low, a.high) == (b.low, b.high);
        self.0.chunk_by(same).map(|uses| ([uses[0].low, uses[0].high], uses))
    }
}

/// Disjoint sets of 0..n whose members are oriented along or against their root. The root is the
/// smallest member, so that the result does not depend on the order of joining.
pub(super) struct Sets {
    /// Parent, and whether the member is oriented against it.
    parent: Vec<(u32, bool)>,
}

impl Sets {
    pub fn new(n: usize) -> Sets {
        Sets { parent: (0..n as u32).map(|i| (i, false)).collect() }
    }

    /// The root of `i`, and whether `i` is oriented against it.
    pub fn find(&mut self, i: u32) -> (u32, bool) {
        let (mut root, mut against) = (i, false);
        while self.parent[root as usize].0 != root {
            let (next, flip) = self.parent[root as usize];
            (root, against) = (next, against ^ flip);
        }
        // Second walk: hang every member of the path on the root.
        let (mut member, mut rest) = (i, against);
        while member != root {
            let (next, flip) = self.parent[member as usize];
            self.parent[member as usize] = (root, rest);
            (member, rest) = (next, rest ^ flip);
        }
        (root, against)
    }

    /// Puts `a` and `b` in one set, `opposite` or alike; without effect when they already are.
    pub fn join(&mut self, a: u32, b: u32, opposite: bool) {
        let ((a, a_against), (b, b_against)) = (self.find(a), self.find(b));
        if a != b {
            let (low, high) = (a.min(b), a.max(b));
            self.parent[high as usize] = (low, a_against ^ b_against ^ opposite);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against an orientation drawn beforehand: joins that agree with it reproduce it.
        #[test]
        fn orientations_are_consistent(
            sides in prop::collection::vec(any::<bool>(), 30),
            joins in prop::collection::vec((0u32..30, 0u32..30), 0..60),
        ) {
            let mut sets = Sets::new(30);
            for (a, b) in joins {
                let opposite = sides[a as usize] != sides[b as usize];
                sets.join(a, b, opposite);
                prop_assert_eq!(sets.find(a).0, sets.find(b).0);
            }
            for i in 0..30 {
                let (root, against) = sets.find(i);
                prop_assert!(root <= i);
                prop_assert_eq!(against, sides[i as usize] != sides[root as usize]);
            }
        }
    }
}
