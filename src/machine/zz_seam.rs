use super::*;
use std::path::Path;
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct E(String);
impl Machine {
    pub const BUILTIN: &[&str] = &["generic-5axis"];
    pub fn builtin(n: &str) -> Option<Machine> { (n == "generic-5axis").then(|| Machine { name: n.into(), workholding: Workholding { pedestal_mm: 50.0, table: Table::Disc { radius_mm: 60.0 } }, tools: vec![Tool::builtin("w2v-cutter").unwrap(), Tool::builtin("w2v-nozzle").unwrap()], max_tilt_deg: 100.0 }) }
    pub fn load(p: &Path) -> Result<Machine, E> { std::fs::read_to_string(p).map_err(|e| E(e.to_string())).and_then(|t| toml::from_str(&t).map_err(|e| E(format!("{}: {e}", p.display())))) }
}
impl Tool {
    pub const BUILTIN: &[&str] = &["w2v-cutter", "w2v-nozzle"];
    pub fn builtin(n: &str) -> Option<Tool> {
        let kind = match n { "w2v-cutter" => ToolKind::Subtractive, "w2v-nozzle" => ToolKind::Additive, _ => return None };
        Some(Tool { name: n.into(), kind, sections: vec![Section { shape: Shape::Ball { radius: 1.5 }, active: true }] })
    }
    pub fn load(p: &Path) -> Result<Tool, E> { std::fs::read_to_string(p).map_err(|e| E(e.to_string())).and_then(|t| toml::from_str(&t).map_err(|e| E(format!("{}: {e}", p.display())))) }
}
pub fn describe(m: &Machine) -> String { format!("{m:#?}") }
pub fn describe_tool(m: &Tool) -> String { format!("{m:#?}") }
pub fn check(_: &Machine) -> Vec<String> { vec![] }
