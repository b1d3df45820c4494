//! `prelight schema`: the JSON schema of scene.toml, for editors.

use super::{Context, Failure, Summary};
use clap::Args;

/// Print the JSON schema of scene.toml
#[derive(Args, Debug)]
pub struct SchemaArgs {}

/// Runs the verb.
pub fn run(_args: SchemaArgs, _context: &Context) -> Result<Summary, Failure> {
    let schema = prelight_manifests::scene::schema();
    let mut summary = Summary::new();
    summary.set_text(format!("{schema:#}\n")).set("schema", schema);
    Ok(summary)
}
