//! Local planes that free what the blocks could not make, at the least loss (W2V Sec. 4.2, App. C).
//!
//! Method. Each element is a layer of a Monte Carlo tree; its options are its candidate planes and,
//! first, none. A choice is valid when every element that must be cleared is cleared, and when the
//! collision dependency graph has no inaccessible point: the samples of the elements, and those of
//! the cells that are given up, since what is given up is cut and printed again. Its value is the
//! number of cells that stay. An integer set cover gives the choice to start from; at the end every
//! plane moves outward as far as the choice stays valid and loses less.
//!
//! Not guaranteed: that a valid choice can be cut and printed block by block; the planner tries.

use super::local::{Candidate, Element, Scope};
use super::{Options, Search};
use crate::access::{
    CellSet, Demand, DependencyGraph, Reachers, Scene, cutter_map, nozzle_map, reachable,
};
use crate::base::{Ctx, Direction};
use crate::machine::{Tool, ToolKind};
use crate::planner::PlanError;
use crate::search::mcts::{self, Budget, Sequence, Strategy};
use crate::search::{WeightedSet, set_cover};
use crate::voxel::BitGrid;
use std::collections::BTreeMap;

/// Points of an element in the graph at most, and of the reused volume: enough to tell one plane
/// from another, few enough that a choice is judged in a fraction of a millisecond.
const ELEMENT_POINTS: usize = 16;
const OWNED_POINTS: usize = 60;

/// Sampled directions of the graph's poses per hemisphere, beside the axes: more make fewer points
/// count as stuck, and the graph slower to make.
const GRAPH_DIRECTIONS: usize = 24;

/// Steps outward, in cells, that the polish tries one after the other for a plane.
const POLISH_STEPS: usize = 6;

/// The chosen planes and how they were found.
pub struct Refined {
    pub chosen: Vec<Candidate>,
    /// Choices judged by the search, and per second.
    pub judged: usize,
    pub per_second: f64,
    /// Points of the graph.
    pub points: usize,
    /// Whether the choice satisfies the graph.
    pub is_valid: bool,
}

/// The search problem.
struct Choice<'a> {
    elements: &'a [Element],
    layers: &'a [Vec<Candidate>],
    graph: &'a DependencyGraph,
    /// Cells given up before.
    before: &'a CellSet,
    cells: usize,
}

impl Choice<'_> {
    fn of(&self, choices: &[usize]) -> impl Iterator<Item = &Candidate> {
        choices.iter().zip(self.layers).filter_map(|(c, l)| c.checked_sub(1).map(|c| &l[c]))
    }

    fn given_up<'c>(&self, chosen: impl Iterator<Item = &'c Candidate>) -> CellSet {
        let mut all = self.before.clone();
        chosen.for_each(|c| all.union_with(&c.lost));
        all
    }

    fn clears_all(&self, choices: &[usize]) -> bool {
        let cleared = |e: usize| self.of(choices).any(|c| c.clears.binary_search(&e).is_ok());
        // An element without a candidate is nobody's to clear.
        (0..self.elements.len())
            .all(|e| !self.elements[e].must || self.layers[e].is_empty() || cleared(e))
    }
}

impl Sequence for Choice<'_> {
    fn layers(&self) -> usize {
        self.layers.len()
    }

    fn options(&self, layer: usize) -> usize {
        self.layers[layer].len() + 1
    }

    fn value(&self, choices: &[usize]) -> Option<f64> {
        if !self.clears_all(choices) {
            return None;
        }
        let given_up = self.given_up(self.of(choices));
        let valid = self.graph.all_accessible(&given_up);
        valid.then(|| (self.cells - given_up.count()) as f64)
    }

    fn bounds(&self) -> (f64, f64) {
        (0.0, (self.cells - self.before.count()) as f64)
    }
}

/// Chooses local planes for the elements; none where no candidate frees any of them.
pub fn refine(
    scope: &Scope,
    regions: Vec<BitGrid>,
    normals: &[Direction],
    before: &BitGrid,
    options: &Options,
    ctx: &Ctx,
) -> Result<Option<Refined>, PlanError> {
    let before = scope.cells.set_of(before);
    let (graph, elements) = graph(scope, regions, &before, options);
    let elements = &elements[..];
    let layers = scope.candidates(elements, normals);
    ctx.check()?;
    if layers.iter().all(Vec::is_empty) {
        return Ok(None);
    }
    let choice = Choice {
        elements,
        layers: &layers,
        graph: &graph,
        before: &before,
        cells: scope.cells.len(),
    };
    let start = covering(&choice)?;
    let started = std::time::Instant::now();
    let strategy = match options.search {
        Search::Random => Strategy::Random,
        _ => Strategy::Tree,
    };
    let budget = Budget { iterations: options.iterations, strategy, seed: options.seed };
    let outcome = mcts::search(&choice, &budget, ctx)?;
    let seconds = started.elapsed().as_secs_f64();
    let mut best = start.clone();
    let mut value = choice.value(&start);
    if let Some(found) = outcome.best
        && value.is_none_or(|v| found.value > v)
    {
        (best, value) = (found.choices, Some(found.value));
    }
    let chosen: Vec<(usize, Candidate)> = best
        .iter()
        .enumerate()
        .filter_map(|(e, c)| Some((e, layers[e][c.checked_sub(1)?].clone())))
        .collect();
    let chosen = match value {
        Some(value) => polished(scope, elements, &choice, chosen, value),
        None => chosen.into_iter().map(|(_, c)| c).collect(),
    };
    Ok(Some(Refined {
        chosen,
        judged: outcome.judged,
        per_second: outcome.judged as f64 / seconds.max(1e-9),
        points: graph.len(),
        is_valid: value.is_some(),
    }))
}

/// A least-weight choice that clears every element that has candidates (W2V Eq. 2).
fn covering(choice: &Choice) -> Result<Vec<usize>, PlanError> {
    let named: Vec<(usize, usize)> = choice
        .layers
        .iter()
        .enumerate()
        .flat_map(|(l, of)| (0..of.len()).map(move |c| (l, c)))
        .collect();
    let wanted: Vec<usize> =
        (0..choice.elements.len()).filter(|e| !choice.layers[*e].is_empty()).collect();
    let sets: Vec<WeightedSet> = named
        .iter()
        .map(|(l, c)| {
            let candidate = &choice.layers[*l][*c];
            let covers = candidate.clears.iter().filter_map(|e| wanted.binary_search(e).ok());
            let weight = candidate.lost_count as f64 / choice.cells.max(1) as f64;
            WeightedSet { weight, covers: covers.collect() }
        })
        .collect();
    let mut choices = vec![0; choice.layers.len()];
    for i in set_cover(wanted.len(), &sets)? {
        choices[named[i].0] = named[i].1 + 1;
    }
    // One layer may give two sets of a cover; the one left out is made up for by the layers that
    // it would have cleared.
    for e in wanted {
        let cleared = choice.of(&choices).any(|c| c.clears.binary_search(&e).is_ok());
        if !cleared {
            choices[e] = 1;
        }
    }
    Ok(choices)
}

/// Every plane moved outward, a cell at a time, while the choice stays valid and keeps more.
fn polished(
    scope: &Scope,
    elements: &[Element],
    choice: &Choice,
    mut chosen: Vec<(usize, Candidate)>,
    mut value: f64,
) -> Vec<Candidate> {
    for i in 0..chosen.len() {
        for _ in 0..POLISH_STEPS {
            let (element, candidate) = &chosen[i];
            let mut plane = candidate.plane;
            plane.offset += scope.job.frame.pitch;
            let Some(further) = scope.at(elements, *element, plane) else { break };
            let mut others: Vec<&Candidate> =
                chosen.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, c)| &c.1).collect();
            let clears = |e: usize| {
                let above = elements[e]
                    .region
                    .iter_ones()
                    .all(|v| plane.normal.dot(scope.job.frame.center(v)) > plane.offset);
                (above && further.clears.binary_search(&e).is_ok())
                    || others.iter().any(|c| c.clears.binary_search(&e).is_ok())
            };
            let all = (0..elements.len())
                .all(|e| !elements[e].must || choice.layers[e].is_empty() || clears(e));
            if !all {
                break;
            }
            others.push(&further);
            let given_up = choice.given_up(others.into_iter());
            let kept = (choice.cells - given_up.count()) as f64;
            if kept <= value || !choice.graph.all_accessible(&given_up) {
                break;
            }
            value = kept;
            chosen[i].1 = further;
        }
    }
    chosen.into_iter().map(|(_, c)| c).collect()
}

/// The graph of the regions' points and of samples of the reused volume, and the regions as
/// elements: one with a point that nothing reaches is freed by whatever frees its points.
fn graph(
    scope: &Scope,
    regions: Vec<BitGrid>,
    before: &CellSet,
    options: &Options,
) -> (DependencyGraph, Vec<Element>) {
    let job = scope.job;
    let frame = &job.frame;
    let mut demands = Vec::new();
    let mut of = Vec::new();
    for region in &regions {
        let removed = region.count_and(&job.initial);
        let kind =
            if 2 * removed > region.count() { ToolKind::Subtractive } else { ToolKind::Additive };
        let voxels: Vec<[usize; 3]> = region.iter_ones().collect();
        let stride = voxels.len().div_ceil(ELEMENT_POINTS).max(1);
        let points = voxels.iter().step_by(stride);
        let first = demands.len();
        demands.extend(points.map(|v| Demand { point: frame.center(*v), kind, owner: None }));
        of.push(first..demands.len());
    }
    let stride = scope.cells.len().div_ceil(OWNED_POINTS).max(1);
    for cell in (0..scope.cells.len()).step_by(stride).filter(|c| !before.contains(*c)) {
        let point = scope.cells.center(cell);
        let kinds = [ToolKind::Subtractive, ToolKind::Additive];
        demands.extend(kinds.map(|kind| Demand { point, kind, owner: Some(cell) }));
    }
    let mut directions: Vec<Direction> = Vec::new();
    for holding in 0..scope.setting.holdings.len() {
        directions.extend(scope.setting.axes(holding));
        directions.extend(scope.setting.sampled(holding, GRAPH_DIRECTIONS.min(options.directions)));
    }
    directions.dedup();
    let longest = |tools| Tool::longest(tools).cloned().into_iter().collect::<Vec<Tool>>();
    let (cutters, nozzles) = (longest(&job.cutters), longest(&job.nozzles));
    let open = open_to(scope, &demands, &directions, &cutters, &nozzles);
    let is_open = |d: &Demand, i: usize, _: &Tool| {
        let kind = usize::from(d.kind == ToolKind::Additive);
        let at = frame.voxel_at(d.point);
        at.is_some_and(|v| open[&(i, kind)].get(v))
    };
    let reachers = Reachers {
        cutters: &cutters,
        nozzles: &nozzles,
        directions: &directions,
        open: &is_open,
        slack_mm: frame.pitch / 2.0,
    };
    let graph = DependencyGraph::new(&scope.cells, &demands, &reachers).without_hopeless();
    let stuck = graph.stuck(before);
    let elements = regions.into_iter().zip(of).map(|(region, of)| {
        let must = !stuck.iter().any(|d| of.contains(d));
        Element { region, must }
    });
    let elements = elements.collect();
    (graph, elements)
}

/// The demands' voxels that table and pedestal leave open, by direction and kind of tool.
fn open_to(
    scope: &Scope,
    demands: &[Demand],
    directions: &[Direction],
    cutters: &[Tool],
    nozzles: &[Tool],
) -> BTreeMap<(usize, usize), BitGrid> {
    use rayon::prelude::*;
    let frame = &scope.job.frame;
    let mut wanted = BitGrid::new(frame.dims);
    demands.iter().filter_map(|d| frame.voxel_at(d.point)).for_each(|v| wanted.set(v, true));
    let nothing = BitGrid::new(frame.dims);
    let open: Vec<[BitGrid; 2]> = directions
        .par_iter()
        .map(|d| {
            let Some(holding) = scope.holding(*d) else {
                return [nothing.clone(), nothing.clone()];
            };
            let scene = Scene::new(frame, &nothing, &scope.fixed[holding]);
            let cut = cutters.iter().map(|t| cutter_map(&scene, &wanted, t, *d));
            let dip = scope.job.rules.nozzle_dip_mm;
            let print = nozzles.iter().map(|t| nozzle_map(&scene, &wanted, t, *d, dip));
            let any = |maps: &mut dyn Iterator<Item = crate::access::DepthMap>| {
                let mut open = nothing.clone();
                maps.for_each(|m| open.union_with(&reachable(&m, &wanted, frame)));
                open
            };
            [any(&mut { cut }), any(&mut { print })]
        })
        .collect();
    let numbered = open.into_iter().enumerate();
    numbered.flat_map(|(i, [a, b])| [((i, 0), a), ((i, 1), b)]).collect()
}
