//! Places the objects of a 3MF package: build items, components of components, transforms.
//!
//! Guarantees: how much is placed is counted before anything is copied, so that a few nested
//! doublings cannot fill the memory; an object that is part of itself is refused.

use super::error::{Defect, Fault, Place};
use super::tri::{TriMesh, is_placeable};
use crate::base::{DAffine3, DVec3};
use std::collections::BTreeMap;

pub(super) type Pose = DAffine3;

/// Components within components. Assemblies nest a handful; the recursion takes stack.
pub(super) const DEEPEST: usize = 64;
/// Triangles, vertices or instances placed, when the file holds fewer itself. More lets a small
/// file fill the memory (8 million take 300 MB), fewer refuses large build plates.
pub(super) const MAX_PLACED: u64 = 8_000_000;

/// One model part of a package.
#[derive(Default)]
pub(super) struct Model {
    pub mm_per_unit: f64,
    pub objects: BTreeMap<String, Object>,
    pub items: Vec<Component>,
}

#[derive(Default)]
pub(super) struct Object {
    pub vertices: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    pub components: Vec<Component>,
}

/// An object placed, maybe from another part.
pub(super) struct Component {
    pub object: String,
    pub path: Option<String>,
    pub pose: Pose,
}

type Models = BTreeMap<String, Model>;

/// An object's part and id.
type Key<'a> = (&'a str, &'a str);

/// What placing an object once takes; counts saturate.
#[derive(Clone, Copy)]
struct Load {
    vertices: u64,
    triangles: u64,
    instances: u64,
    height: usize,
}

/// The mesh of everything that the build of the part `root` places, in millimetres times
/// `scale`. A file without build items is taken as all objects that are no components.
pub(super) fn place(models: &Models, root: &str, scale: f64) -> Result<TriMesh, Fault> {
    let model = &models[root];
    let loose = loose_items(model);
    let items = if model.items.is_empty() { &loose } else { &model.items };
    let mut known = BTreeMap::new();
    let mut total = Load { vertices: 0, triangles: 0, instances: 0, height: 0 };
    for item in items {
        total.add(load(models, target(root, item), 0, &mut known)?);
    }
    let all = || models.values().flat_map(|m| m.objects.values());
    let vertices: usize = all().map(|o| o.vertices.len()).sum();
    let triangles: usize = all().map(|o| o.triangles.len()).sum();
    let limit = MAX_PLACED.max(vertices as u64).max(triangles as u64);
    if total.vertices.max(total.triangles).max(total.instances) > limit {
        let triangles = total.triangles;
        return Err((Place::File, Defect::TooManyInstances { triangles, limit }));
    }
    let mut placed = Placed::default();
    placed.vertices.reserve(total.vertices as usize);
    placed.triangles.reserve(total.triangles as usize);
    let world_from_unit = Pose::from_scale(DVec3::splat(model.mm_per_unit * scale));
    for item in items {
        placed.add(models, target(root, item), world_from_unit * item.pose)?;
    }
    if placed.triangles.is_empty() {
        return Err((Place::File, Defect::NoFaces { vertices: placed.vertices.len() }));
    }
    TriMesh::new(placed.vertices, placed.triangles).map_err(|e| (Place::File, e.into()))
}

fn loose_items(model: &Model) -> Vec<Component> {
    let used: std::collections::BTreeSet<&str> = model
        .objects
        .values()
        .flat_map(|o| &o.components)
        .filter(|c| c.path.is_none())
        .map(|c| c.object.as_str())
        .collect();
    let free = model.objects.keys().filter(|id| !used.contains(id.as_str()));
    free.map(|id| Component { object: id.clone(), path: None, pose: Pose::IDENTITY }).collect()
}

/// The object that a component of the part `part` names.
fn target<'a>(part: &'a str, component: &'a Component) -> Key<'a> {
    (component.path.as_deref().unwrap_or(part), &component.object)
}

fn bad(object: &str) -> Fault {
    (Place::File, Defect::BadComponent { object: object.to_string(), limit: DEEPEST })
}

impl Load {
    fn add(&mut self, child: Load) {
        self.vertices = self.vertices.saturating_add(child.vertices);
        self.triangles = self.triangles.saturating_add(child.triangles);
        self.instances = self.instances.saturating_add(child.instances);
        self.height = self.height.max(child.height + 1);
    }
}

/// Counts what one placing of `key` takes, each object once. A cycle runs into the depth limit.
fn load<'a>(
    models: &'a Models,
    key: Key<'a>,
    depth: usize,
    known: &mut BTreeMap<Key<'a>, Load>,
) -> Result<Load, Fault> {
    let (part, id) = key;
    if let Some(load) = known.get(&key) {
        return if depth + load.height > DEEPEST { Err(bad(id)) } else { Ok(*load) };
    }
    let object = models.get(part).and_then(|m| m.objects.get(id)).ok_or_else(|| bad(id))?;
    if depth >= DEEPEST {
        return Err(bad(id));
    }
    let mut sum = Load {
        vertices: object.vertices.len() as u64,
        triangles: object.triangles.len() as u64,
        instances: 1,
        height: 0,
    };
    for component in &object.components {
        sum.add(load(models, target(part, component), depth + 1, known)?);
    }
    known.insert(key, sum);
    Ok(sum)
}

#[derive(Default)]
struct Placed {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Placed {
    /// Adds an object whose components were counted before; depth and number are bounded by that.
    fn add(&mut self, models: &Models, (part, id): Key, pose: Pose) -> Result<(), Fault> {
        let object = &models[part].objects[id];
        let first = u32::try_from(self.vertices.len()).map_err(|_| bad(id))?;
        for v in &object.vertices {
            let p = pose.transform_point3(*v);
            for (mm, value) in p.to_array().into_iter().zip(v.to_array()) {
                if !is_placeable(mm) {
                    return Err((Place::File, Defect::Coordinate { value }));
                }
            }
            self.vertices.push(p);
        }
        let mirrors = pose.matrix3.determinant() < 0.0;
        self.triangles.extend(object.triangles.iter().map(|t| {
            let [a, b, c] = t.map(|i| i + first);
            if mirrors { [a, c, b] } else { [a, b, c] }
        }));
        for component in &object.components {
            self.add(models, target(part, component), pose * component.pose)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn component(object: &str, pose: Pose) -> Component {
        Component { object: object.to_string(), path: None, pose }
    }

    fn model(objects: Vec<(&str, Object)>, items: Vec<Component>) -> Models {
        let objects = objects.into_iter().map(|(id, o)| (id.to_string(), o)).collect();
        BTreeMap::from([("m".to_string(), Model { mm_per_unit: 10.0, objects, items })])
    }

    fn cube() -> Object {
        let m = TriMesh::cuboid(DVec3::ZERO, DVec3::ONE);
        Object {
            vertices: m.vertices().to_vec(),
            triangles: m.triangles().to_vec(),
            components: vec![],
        }
    }

    #[test]
    fn transforms_compose_inner_first_and_mirrors_keep_the_outside() {
        let mirror = Pose::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let shift = Pose::from_translation(DVec3::new(3.0, 0.0, 0.0));
        let pair = Object { components: vec![component("1", mirror)], ..Object::default() };
        let models = model(vec![("1", cube()), ("2", pair)], vec![component("2", shift)]);
        let mesh = place(&models, "m", 0.5).unwrap();
        assert_eq!(mesh.bounds().min.x, 10.0);
        assert_eq!(mesh.bounds().max.x, 15.0);
        assert!((mesh.signed_volume() - 125.0).abs() < 1e-9);
    }

    #[test]
    fn doublings_cycles_and_deep_chains_are_refused() {
        let twice = |id: &str| Object {
            components: vec![component(id, Pose::IDENTITY), component(id, Pose::IDENTITY)],
            ..Object::default()
        };
        let ids: Vec<String> = (0..40).map(|i| i.to_string()).collect();
        let mut objects: Vec<(&str, Object)> =
            (1..40).map(|i| (ids[i].as_str(), twice(&ids[i - 1]))).collect();
        objects.push(("0", cube()));
        let doubled = place(&model(objects, vec![component("39", Pose::IDENTITY)]), "m", 1.0);
        assert!(matches!(doubled, Err((_, Defect::TooManyInstances { .. }))));

        let cycle = model(vec![("a", twice("a"))], vec![component("a", Pose::IDENTITY)]);
        assert!(matches!(place(&cycle, "m", 1.0), Err((_, Defect::BadComponent { .. }))));

        let ids: Vec<String> = (0..100_000).map(|i| format!("{i:06}")).collect();
        let chain: Vec<(&str, Object)> = (1..ids.len())
            .map(|i| {
                let components = vec![component(&ids[i - 1], Pose::IDENTITY)];
                (ids[i].as_str(), Object { components, ..Object::default() })
            })
            .chain([(ids[0].as_str(), cube())])
            .collect();
        let items = ids.iter().map(|id| component(id, Pose::IDENTITY)).collect();
        assert!(matches!(
            place(&model(chain, items), "m", 1.0),
            Err((_, Defect::BadComponent { .. }))
        ));
    }
}
