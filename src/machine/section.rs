//! Reading a section: all keys of all shapes in one flat list, so that a misspelt key is answered
//! with every key there is and a key of another shape with those of this one.

use super::revolved::frusta;
use super::tool::{Section, Shape};
use crate::mesh::{self, Health};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de::Error};
use std::path::{Path, PathBuf};

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Ball,
    BullNose,
    Frustum,
    Platform,
    Mesh,
}

/// What a tool file may say of a section.
#[derive(JsonSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "describes files; they are read as `Flat`")]
pub(super) enum Written {
    Round(Section),
    Drawn(Drawn),
}

/// A closed mesh in mm, its tip at the origin and the tool's axis along +z: a shank, a holder, a nozzle or a
/// head. It takes the room that it sweeps when it turns about that axis.
#[derive(JsonSchema)]
#[serde(rename = "Mesh", deny_unknown_fields)]
#[allow(dead_code, reason = "describes files; they are read as `Flat`")]
pub(super) struct Drawn {
    shape: MeshShape,
    /// An OBJ, STL, PLY, OFF or 3MF file, from the tool file's folder.
    file: PathBuf,
}

#[derive(JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[allow(dead_code, reason = "describes files; they are read as `Kind`")]
enum MeshShape {
    Mesh,
}

#[derive(Deserialize)]
#[serde(rename = "Section", deny_unknown_fields)]
pub(super) struct Flat {
    shape: Kind,
    #[serde(default)]
    active: bool,
    radius: Option<f64>,
    corner: Option<f64>,
    z: Option<f64>,
    z0: Option<f64>,
    r0: Option<f64>,
    z1: Option<f64>,
    r1: Option<f64>,
    file: Option<PathBuf>,
}

impl Flat {
    /// The figures of this shape in the order of `keys`; no other figure may be given.
    fn figures<const N: usize>(&self, shape: &str, keys: [&str; N]) -> Result<[f64; N], String> {
        let given = [
            ("radius", self.radius),
            ("corner", self.corner),
            ("z", self.z),
            ("z0", self.z0),
            ("r0", self.r0),
            ("z1", self.z1),
            ("r1", self.r1),
        ];
        let takes = || format!("a {shape} takes {}", keys.join(", "));
        if self.file.is_some() {
            return Err(format!("key `file` does not belong here; {}", takes()));
        }
        if let Some((key, _)) = given.iter().find(|(k, v)| v.is_some() && !keys.contains(k)) {
            return Err(format!("key `{key}` does not belong here; {}", takes()));
        }
        let mut figures = [0.0; N];
        for (figure, key) in figures.iter_mut().zip(keys) {
            let value = given.iter().find(|(k, _)| *k == key).and_then(|(_, v)| *v);
            *figure = value.ok_or_else(|| format!("key `{key}` is missing; {}", takes()))?;
        }
        Ok(figures)
    }

    fn section(&self) -> Result<Section, String> {
        let shape = match self.shape {
            Kind::Ball => {
                let [radius] = self.figures("ball", ["radius"])?;
                Shape::Ball { radius }
            }
            Kind::BullNose => {
                let [radius, corner] = self.figures("bull-nose", ["radius", "corner"])?;
                Shape::BullNose { radius, corner }
            }
            Kind::Frustum => {
                let [z0, r0, z1, r1] = self.figures("frustum", ["z0", "r0", "z1", "r1"])?;
                Shape::Frustum { z0, r0, z1, r1 }
            }
            Kind::Platform => {
                let [z] = self.figures("platform", ["z"])?;
                Shape::Platform { z }
            }
            Kind::Mesh => {
                return Err("a mesh belongs into a tool file of its own; name that file with \
                            --sm-tool or --am-tool"
                    .into());
            }
        };
        Ok(Section { shape, active: self.active })
    }

    pub(super) fn is_mesh(&self) -> bool {
        matches!(self.shape, Kind::Mesh)
    }

    /// The sections that this one of a tool file in `folder` stands for.
    pub(super) fn sections(&self, folder: &Path) -> Result<Vec<Section>, String> {
        let (Kind::Mesh, Some(file)) = (self.shape, &self.file) else {
            return match self.shape {
                Kind::Mesh => Err("key `file` is missing; a mesh takes file".into()),
                _ => self.section().map(|s| vec![s]),
            };
        };
        let Flat { file: _, shape: _, active, radius, corner, z, z0, r0, z1, r1 } = self;
        if [radius, corner, z, z0, r0, z1, r1].into_iter().any(Option::is_some) {
            return Err("a mesh takes file, and nothing else".into());
        }
        if *active {
            return Err(
                "an edge is drawn as ball, bull-nose or frustum; a shank, a holder or a nozzle \
                        may be a mesh"
                    .into(),
            );
        }
        let path = folder.join(file);
        let read = mesh::read(&path, &mesh::ReadOptions::default()).map_err(|e| e.to_string())?;
        let named = |what: String| format!("{}: {what}", path.display());
        if !Health::of(&read.mesh).watertight {
            return Err(named("the mesh is not closed; a tool needs a closed surface".into()));
        }
        let shapes = frusta(&read.mesh).map_err(named)?;
        Ok(shapes.into_iter().map(|shape| Section { shape, active: false }).collect())
    }
}

impl<'de> Deserialize<'de> for Section {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Section, D::Error> {
        Flat::deserialize(deserializer)?.section().map_err(D::Error::custom)
    }
}

/// A list of sections; an error says which one it is about, counted from 1.
pub(super) fn numbered<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Section>, D::Error> {
    let flat: Vec<Flat> = Vec::deserialize(from)?;
    let read = |(i, f): (usize, &Flat)| {
        f.section().map_err(|what| D::Error::custom(format!("section {}: {what}", i + 1)))
    };
    flat.iter().enumerate().map(read).collect()
}
