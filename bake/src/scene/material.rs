//! Materials, and which texture coordinates their textures read.
//!
//! A surface has two sets of texture coordinates; a glTF texture may name any set and transform it (KHR_texture_transform). So each
//! material gets two *slots*, a slot being (set of the file, transform), and the loader fills a primitive's sets by the slots of
//! its material: u' = o_u + cos(r)·s_u·u + sin(r)·s_v·v, v' = o_v − sin(r)·s_u·u + cos(r)·s_v·v, in f64, rounded once.

use super::error::{SceneError, Source};
use super::texture::Wanted;
use super::warnings::{Warnings, label};
use gltf::json::material::AlphaMode as JsonAlpha;
use gltf::json::texture::{MagFilter, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};
use prelight_runtime::surface::{AlphaMode, Material, TextureEncoding, TextureRef, Wrap};
use serde_json::{Map, Value};

/// Rows of an affine map of texture coordinates: u' = a·u + b·v + c.
pub(super) type UvTransform = [[f64; 3]; 2];

const IDENTITY: UvTransform = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// Where one set of a surface's texture coordinates comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slot {
    /// n of TEXCOORD_n.
    pub set: u32,
    pub transform: UvTransform,
}

impl Slot {
    /// The coordinates that a surface sees.
    pub fn apply(&self, uv: [f32; 2]) -> [f32; 2] {
        if self.transform == IDENTITY {
            return uv;
        }
        let [u, v] = uv.map(f64::from);
        self.transform.map(|[a, b, c]| (a * u + b * v + c) as f32)
    }
}

/// A material and its slots.
#[derive(Clone, Debug)]
pub(super) struct Resolved {
    pub material: Material,
    pub slots: [Slot; 2],
}

impl Default for Resolved {
    /// The default material, sets 0 and 1 as they are.
    fn default() -> Self {
        let slot = |set| Slot { set, transform: IDENTITY };
        Resolved { material: Material::default(), slots: [slot(0), slot(1)] }
    }
}

/// Extensions of a texture reference.
type Others<'a> = Option<&'a Map<String, Value>>;

/// One texture reference of the file.
struct Info<'a> {
    texture: Index<gltf::json::Texture>,
    set: u32,
    others: Others<'a>,
    encoding: TextureEncoding,
    what: &'static str,
}

/// Reads one material. Textures of materials that nothing uses are left out, so that they are never decoded.
pub(super) fn read(
    source: Source,
    root: &Root,
    index: usize,
    in_use: bool,
    wanted: &mut Wanted,
    warnings: &mut Warnings,
) -> Result<Resolved, SceneError> {
    let json = &root.materials[index];
    let at = || label("materials", index, json.name.as_deref());
    let pbr = &json.pbr_metallic_roughness;
    let alpha_mode = match json.alpha_mode {
        Checked::Valid(JsonAlpha::Mask) => AlphaMode::Mask { cutoff: json.alpha_cutoff.unwrap_or_default().0 },
        Checked::Valid(JsonAlpha::Blend) => AlphaMode::Blend,
        _ => AlphaMode::Opaque,
    };
    let extensions = json.extensions.as_ref().map(|e| &e.others);
    let number = |extension: &str, field: &str| -> Result<Option<f32>, SceneError> {
        match extensions.and_then(|e| e.get(extension)).and_then(|e| e.get(field)) {
            None => Ok(None),
            Some(value) => match value.as_f64() {
                Some(number) => Ok(Some(number as f32)),
                None => Err(source.invalid(format!("{}.extensions.{extension}.{field}", at()), "not a number")),
            },
        }
    };
    let strength = number("KHR_materials_emissive_strength", "emissiveStrength")?.unwrap_or(1.0);
    let transmission = number("KHR_materials_transmission", "transmissionFactor")?.unwrap_or(0.0);
    let mut material = Material {
        name: json.name.clone().unwrap_or_default(),
        base_color: pbr.base_color_factor.0,
        metallic: pbr.metallic_factor.0,
        roughness: pbr.roughness_factor.0,
        emissive: json.emissive_factor.0.map(|e| e * strength),
        normal_scale: json.normal_texture.as_ref().map_or(1.0, |n| n.scale),
        alpha_mode,
        double_sided: json.double_sided,
        ..Material::default()
    };
    let cutoff = if let AlphaMode::Mask { cutoff } = alpha_mode { cutoff } else { 0.0 };
    let factors = [material.metallic, material.roughness, material.normal_scale, cutoff, transmission];
    if !material.base_color.iter().chain(&material.emissive).chain(&factors).all(|x| x.is_finite()) {
        return Err(source.invalid(at(), "a factor that is not a finite number"));
    }
    let within = |x: f32| x.clamp(0.0, 1.0);
    let clamped = Material {
        base_color: material.base_color.map(within),
        metallic: within(material.metallic),
        roughness: within(material.roughness),
        emissive: material.emissive.map(|e| e.max(0.0)),
        ..material.clone()
    };
    if clamped != material {
        warnings.note("a material's factor outside its range is clamped", at);
        material = clamped;
    }
    if transmission > 0.0 && alpha_mode == AlphaMode::Opaque {
        material.alpha_mode = AlphaMode::Blend;
        material.base_color[3] *= 1.0 - within(transmission);
    }
    let mut resolved = Resolved { material, ..Resolved::default() };
    if !in_use {
        return Ok(resolved);
    }
    if resolved.material.emissive.iter().any(|&e| e > 0.0) {
        warnings.note("emission is shown, but does not light the scene", at);
    }
    if json.occlusion_texture.is_some() {
        warnings.note("a baked occlusion texture is left out: occlusion is computed", at);
    }

    let plain = |info: &'_ Option<gltf::json::texture::Info>| info.as_ref().map(|i| (i.index, i.tex_coord));
    let others = |info: &'_ Option<gltf::json::texture::Info>| info.as_ref().and_then(|i| i.extensions.as_ref()).map(|e| e.others.clone());
    let normal = json.normal_texture.as_ref().map(|n| (n.index, n.tex_coord));
    let normal_others = json.normal_texture.as_ref().and_then(|n| n.extensions.as_ref()).map(|e| e.others.clone());
    let (srgb, linear) = (TextureEncoding::Srgb, TextureEncoding::Linear);
    let uses = [
        (plain(&pbr.base_color_texture), others(&pbr.base_color_texture), srgb, "base colour"),
        (plain(&pbr.metallic_roughness_texture), others(&pbr.metallic_roughness_texture), linear, "metallic-roughness"),
        (normal, normal_others, linear, "normal"),
        (plain(&json.emissive_texture), others(&json.emissive_texture), srgb, "emissive"),
    ];
    let mut taken: [Option<Slot>; 2] = [None; 2];
    let mut references = [None; 4];
    for (reference, (texture, others, encoding, what)) in references.iter_mut().zip(uses) {
        let Some((texture, set)) = texture else { continue };
        let info = Info { texture, set, others: others.as_ref(), encoding, what };
        *reference = resolve(source, root, &at(), info, &mut taken, wanted, warnings)?;
    }
    let [base, rough, normal, emissive] = references;
    resolved.material.base_color_texture = base;
    resolved.material.metallic_roughness_texture = rough;
    resolved.material.normal_texture = normal;
    resolved.material.emissive_texture = emissive;
    for (slot, taken) in resolved.slots.iter_mut().zip(taken) {
        *slot = taken.unwrap_or(*slot);
    }
    Ok(resolved)
}

fn resolve(
    source: Source,
    root: &Root,
    at: &str,
    info: Info,
    taken: &mut [Option<Slot>; 2],
    wanted: &mut Wanted,
    warnings: &mut Warnings,
) -> Result<Option<TextureRef>, SceneError> {
    let slot = slot_of(source, at, &info)?;
    // A set keeps its own number where it can, so that plain files read as they stand.
    let own = (slot.set as usize).min(1);
    let fits = |k: usize, taken: &[Option<Slot>; 2]| taken[k].is_none_or(|other| other == slot);
    let Some(place) = [own, 1 - own].into_iter().find(|&k| taken[k] == Some(slot)).or([own, 1 - own].into_iter().find(|&k| fits(k, taken)))
    else {
        let kind =
            format!("a material uses more than two sets or transforms of texture coordinates: its {} texture is left out", info.what);
        warnings.note(&kind, || at.to_string());
        return Ok(None);
    };
    let index = info.texture.value();
    let texture = root.textures.get(index).ok_or_else(|| source.invalid(at, "a texture that does not exist"))?;
    if texture.source.value() >= root.images.len() {
        return Err(source.invalid(format!("textures[{index}]"), "a texture without an image"));
    }
    taken[place] = Some(slot);
    let sampler = texture.sampler.and_then(|sampler| root.samplers.get(sampler.value()));
    let wrap = |mode: Checked<WrappingMode>| match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        _ => Wrap::Repeat,
    };
    Ok(Some(TextureRef {
        texture: wanted.index(texture.source.value(), info.encoding),
        uv_set: place as u32,
        wrap: sampler.map_or([Wrap::Repeat; 2], |s| [wrap(s.wrap_s), wrap(s.wrap_t)]),
        nearest: sampler.is_some_and(|s| matches!(s.mag_filter, Some(Checked::Valid(MagFilter::Nearest)))),
    }))
}

fn slot_of(source: Source, at: &str, info: &Info) -> Result<Slot, SceneError> {
    let mut slot = Slot { set: info.set, transform: IDENTITY };
    let Some(transform) = info.others.and_then(|others| others.get("KHR_texture_transform")) else { return Ok(slot) };
    let invalid = || source.invalid(at, "a KHR_texture_transform that is not numbers");
    let pair = |key: &str, default: f64| -> Result<[f64; 2], SceneError> {
        let Some(value) = transform.get(key) else { return Ok([default; 2]) };
        match value.as_array().map(Vec::as_slice) {
            Some([a, b]) => Ok([a.as_f64().ok_or_else(invalid)?, b.as_f64().ok_or_else(invalid)?]),
            _ => Err(invalid()),
        }
    };
    let offset = pair("offset", 0.0)?;
    let scale = pair("scale", 1.0)?;
    let rotation = transform.get("rotation").map_or(Some(0.0), Value::as_f64).ok_or_else(invalid)?;
    if let Some(set) = transform.get("texCoord") {
        slot.set = set.as_u64().and_then(|set| u32::try_from(set).ok()).ok_or_else(invalid)?;
    }
    let (sin, cos) = (libm::sin(rotation), libm::cos(rotation));
    slot.transform = [[cos * scale[0], sin * scale[1], offset[0]], [-sin * scale[0], cos * scale[1], offset[1]]];
    if rotation == 0.0 && scale == [1.0; 2] && offset == [0.0; 2] {
        slot.transform = IDENTITY;
    }
    Ok(slot)
}
