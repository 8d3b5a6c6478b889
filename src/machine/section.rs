//! Reading a section: all keys of all shapes in one flat list, so that a misspelt key is answered
//! with every key there is and a key of another shape with those of this one.

use super::tool::{Section, Shape};
use serde::{Deserialize, Deserializer, de::Error};

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Ball,
    BullNose,
    Frustum,
    Platform,
}

#[derive(Deserialize)]
#[serde(rename = "Section", deny_unknown_fields)]
struct Flat {
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
        };
        Ok(Section { shape, active: self.active })
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
