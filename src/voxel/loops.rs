//! Rims of open surfaces: closed loops of edges that the triangles leave unbalanced, and the cones
//! that close them.

use crate::base::DVec3;

/// A directed edge between two vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Edge {
    pub from: u32,
    pub to: u32,
}

/// The directed edges that a set of triangles uses more often than their reverses, as often as
/// the difference. They form closed loops whatever the triangles are, since each triangle does.
pub(super) fn unbalanced_edges(triangles: &[[u32; 3]]) -> Vec<Edge> {
    use rayon::prelude::*;
    let mut uses: Vec<(u32, u32, bool)> = triangles
        .par_iter()
        .flat_map_iter(|&[a, b, c]| {
            [(a, b), (b, c), (c, a)].map(|(u, v)| (u.min(v), u.max(v), u < v))
        })
        .collect();
    uses.par_sort_unstable();
    let mut rim = Vec::new();
    for e in uses.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let forward = e.iter().filter(|u| u.2).count();
        let backward = e.len() - forward;
        let (lo, hi) = (e[0].0, e[0].1);
        let edge =
            if forward > backward { Edge { from: lo, to: hi } } else { Edge { from: hi, to: lo } };
        rim.extend(std::iter::repeat_n(edge, forward.abs_diff(backward)));
    }
    rim
}

/// Splits balanced directed edges into loops that visit no vertex twice, so that each loop is as
/// small as a walk along the rim finds it.
pub(super) fn boundary_loops(mut edges: Vec<Edge>) -> Vec<Vec<u32>> {
    edges.sort_unstable();
    let mut used = vec![false; edges.len()];
    let mut on_walk = std::collections::BTreeMap::new();
    let mut loops = Vec::new();
    // First edge of each start vertex that may be unused; every edge is passed over once.
    let mut next: std::collections::BTreeMap<u32, usize> = std::collections::BTreeMap::new();
    for (i, e) in edges.iter().enumerate() {
        next.entry(e.from).or_insert(i);
    }
    for start in 0..edges.len() {
        if used[start] {
            continue;
        }
        let mut walk = vec![edges[start].from];
        on_walk.clear();
        on_walk.insert(edges[start].from, 0usize);
        while let Some(&at) = walk.last() {
            let Some(i) = next.get_mut(&at) else { break };
            while *i < edges.len() && edges[*i].from == at && used[*i] {
                *i += 1;
            }
            if *i == edges.len() || edges[*i].from != at {
                break;
            }
            used[*i] = true;
            let to = edges[*i].to;
            if let Some(&since) = on_walk.get(&to) {
                let done: Vec<u32> = walk.drain(since..).collect();
                done.iter().for_each(|v| {
                    on_walk.remove(v);
                });
                loops.push(done);
            }
            on_walk.insert(to, walk.len());
            walk.push(to);
        }
    }
    loops
}

/// Triangles from a loop of rim points to its centroid moved by `nudge`, oriented so that with
/// the surface they balance every edge of the rim.
pub(super) fn cone(points: &[DVec3], nudge: DVec3) -> impl Iterator<Item = [DVec3; 3]> + '_ {
    let apex = points.iter().sum::<DVec3>() / points.len() as f64 + nudge;
    let n = points.len();
    (0..n).map(move |i| [apex, points[(i + 1) % n], points[i]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_soup_leaves_whole_loops(
            triangles in proptest::collection::vec(proptest::array::uniform3(0u32..12), 1..60)
        ) {
            let triangles: Vec<_> =
                triangles.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect();
            let mut rim = unbalanced_edges(&triangles);
            let mut again: Vec<Edge> = boundary_loops(rim.clone())
                .iter()
                .flat_map(|l| {
                    (0..l.len()).map(|i| Edge { from: l[i], to: l[(i + 1) % l.len()] })
                })
                .collect();
            again.sort_unstable();
            rim.sort_unstable();
            prop_assert_eq!(again, rim);
        }
    }
}
