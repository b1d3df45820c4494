//! Materials, and which texture coordinates their textures read.
//!
//! A surface has two sets of texture coordinates; a glTF texture may name any set and transform it (KHR_texture_transform). So each
//! material gets two *slots*, a slot being (set of the file, transform), and the loader fills a primitive's sets by the slots of
//! its material: u' = o_u + cos(r)·s_u·u + sin(r)·s_v·v, v' = o_v − sin(r)·s_u·u + cos(r)·s_v·v, in f64, rounded once. Where a material
//! has more than two of them, its slots are the file's sets as they are, and each texture reference carries its transform. A
//! third *set* in one material is left out with a warning.

use super::error::{SceneError, Source};
use super::lobes;
use super::texture::{self, Make, Wanted};
use super::warnings::{Warnings, label};
use gltf::json::Root;
use gltf::json::material::AlphaMode as JsonAlpha;
use gltf::json::texture::{MagFilter, WrappingMode};
use gltf::json::validation::Checked;
use prelight_runtime::surface::{AlphaMode, Material, TextureEncoding, TextureRef, Wrap};
use serde_json::Value;

/// Rows of an affine map of texture coordinates: u' = a·u + b·v + c.
pub(crate) type UvTransform = [[f64; 3]; 2];

const TRANSFORM: &str = "KHR_texture_transform";
const IDENTITY: UvTransform = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// Where one set of a surface's texture coordinates comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slot {
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
pub(crate) struct Resolved {
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

/// One texture reference of the file, and where it goes.
pub(crate) struct Use {
    /// The material's place for it.
    pub place: fn(&mut Material) -> &mut Option<TextureRef>,
    /// Index into the file's textures.
    pub texture: usize,
    /// n of TEXCOORD_n.
    pub set: u32,
    /// KHR_texture_transform.
    pub transform: Option<Value>,
    pub encoding: TextureEncoding,
    pub make: Make,
    /// For messages.
    pub what: &'static str,
}

/// Reads one material. Textures of materials that nothing uses are left out, so that they are never decoded.
pub(crate) fn read(
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
    let mut material = Material {
        name: json.name.clone().unwrap_or_default(),
        base_color: pbr.base_color_factor.0,
        metallic: pbr.metallic_factor.0,
        roughness: pbr.roughness_factor.0,
        emissive: json.emissive_factor.0,
        normal_scale: json.normal_texture.as_ref().map_or(1.0, |n| n.scale),
        alpha_mode,
        double_sided: json.double_sided,
        ..Material::default()
    };
    let mut uses = plain_uses(json);
    let others = json.extensions.as_ref().map(|e| &e.others);
    let transmission = others.map_or(Ok(0.0), |others| lobes::read(source, &at(), others, &mut material, &mut uses))?;
    let cutoff = if let AlphaMode::Mask { cutoff } = alpha_mode { cutoff } else { 0.0 };
    let factors = [material.metallic, material.roughness, material.normal_scale, cutoff, transmission];
    if !material.base_color.iter().chain(&material.emissive).chain(&factors).all(|x| x.is_finite()) {
        return Err(source.invalid(at(), "a factor that is not a finite number"));
    }
    let clamped = clamped(&material);
    if clamped != material {
        warnings.note("a material's factor outside its range is clamped", at);
        material = clamped;
    }
    if transmission > 0.0 && alpha_mode == AlphaMode::Opaque {
        material.alpha_mode = AlphaMode::Blend;
        material.base_color[3] *= 1.0 - transmission.clamp(0.0, 1.0);
    }
    let mut resolved = Resolved { material, ..Resolved::default() };
    if !in_use {
        return Ok(resolved);
    }
    if resolved.material.emissive.iter().any(|&e| e > 0.0) {
        warnings.note("emission lights the scene by bounces alone: small bright surfaces leave noise", at);
    }
    if json.occlusion_texture.is_some() {
        warnings.note("a baked occlusion texture is left out: occlusion is computed", at);
    }
    let slots: Vec<Slot> = uses.iter().map(|usage| slot_of(source, &at(), usage)).collect::<Result<_, _>>()?;
    let fits = slots.iter().all(|slot| *slot == slots[0] || slots.iter().find(|other| **other != slots[0]) == Some(slot));
    let mut taken: [Option<Slot>; 2] = [None; 2];
    for (usage, slot) in uses.iter().zip(slots) {
        let transform = (!fits && slot.transform != IDENTITY).then(|| slot.transform.map(|row| row.map(|x| x as f32)));
        let slot = if fits { slot } else { Slot { transform: IDENTITY, ..slot } };
        let reference = resolve(source, root, &at(), (usage, slot), &mut taken, wanted, warnings)?;
        *(usage.place)(&mut resolved.material) = reference.map(|reference| TextureRef { transform, ..reference });
    }
    for (slot, taken) in resolved.slots.iter_mut().zip(taken) {
        *slot = taken.unwrap_or(*slot);
    }
    Ok(resolved)
}

/// The textures of glTF itself, the most visible first: where texture coordinates run out, the last are left out.
fn plain_uses(json: &gltf::json::Material) -> Vec<Use> {
    type Info = gltf::json::texture::Info;
    let (srgb, linear) = (TextureEncoding::Srgb, TextureEncoding::Linear);
    let transform = |others: Option<&serde_json::Map<String, Value>>| others.and_then(|others| others.get(TRANSFORM)).cloned();
    let pbr = &json.pbr_metallic_roughness;
    let infos: [(&Option<Info>, fn(&mut Material) -> &mut Option<TextureRef>, _, _); 3] = [
        (&pbr.base_color_texture, |m| &mut m.base_color_texture, srgb, "base colour"),
        (&pbr.metallic_roughness_texture, |m| &mut m.metallic_roughness_texture, linear, "metallic-roughness"),
        (&json.emissive_texture, |m| &mut m.emissive_texture, srgb, "emissive"),
    ];
    let mut uses = Vec::new();
    for (info, place, encoding, what) in infos {
        if let Some(info) = info {
            let transform = transform(info.extensions.as_ref().map(|e| &e.others));
            uses.push(Use { place, texture: info.index.value(), set: info.tex_coord, transform, encoding, make: Make::Copy, what });
        }
    }
    if let Some(info) = &json.normal_texture {
        let transform = transform(info.extensions.as_ref().map(|e| &e.others));
        let place: fn(&mut Material) -> &mut Option<TextureRef> = |m| &mut m.normal_texture;
        let at = uses.iter().position(|usage| usage.what == "emissive").unwrap_or(uses.len());
        let (texture, set) = (info.index.value(), info.tex_coord);
        uses.insert(at, Use { place, texture, set, transform, encoding: linear, make: Make::Copy, what: "normal" });
    }
    uses
}

/// Largest factor: what an asset may hold.
const LARGEST: f32 = 1e18;

fn clamped(material: &Material) -> Material {
    let within = |x: f32| x.clamp(0.0, 1.0);
    Material {
        base_color: material.base_color.map(within),
        metallic: within(material.metallic),
        roughness: within(material.roughness),
        emissive: material.emissive.map(|e| e.clamp(0.0, LARGEST)),
        ior: if material.ior > 0.0 { material.ior.clamp(1.0, LARGEST) } else { 0.0 },
        specular: within(material.specular),
        specular_color: material.specular_color.map(|x| x.clamp(0.0, LARGEST)),
        anisotropy: within(material.anisotropy),
        clearcoat: within(material.clearcoat),
        clearcoat_roughness: within(material.clearcoat_roughness),
        ..material.clone()
    }
}

fn resolve(
    source: Source,
    root: &Root,
    at: &str,
    (usage, slot): (&Use, Slot),
    taken: &mut [Option<Slot>; 2],
    wanted: &mut Wanted,
    warnings: &mut Warnings,
) -> Result<Option<TextureRef>, SceneError> {
    // A set keeps its own number where it can, so that plain files read as they stand.
    let own = (slot.set as usize).min(1);
    let fits = |k: usize, taken: &[Option<Slot>; 2]| taken[k].is_none_or(|other| other == slot);
    let Some(place) = [own, 1 - own].into_iter().find(|&k| taken[k] == Some(slot)).or([own, 1 - own].into_iter().find(|&k| fits(k, taken)))
    else {
        let kind = format!("a material uses more than two sets of texture coordinates: its {} texture is left out", usage.what);
        warnings.note(&kind, || at.to_string());
        return Ok(None);
    };
    let index = usage.texture;
    let texture = root.textures.get(index).ok_or_else(|| source.invalid(at, "a texture that does not exist"))?;
    let Some(image) = texture::image_of(source, root, index)? else {
        warnings.note("a texture without an image is left out, its factor stays", || {
            format!("{at}, {}", label("textures", index, texture.name.as_deref()))
        });
        return Ok(None);
    };
    taken[place] = Some(slot);
    let sampler = texture.sampler.and_then(|sampler| root.samplers.get(sampler.value()));
    let wrap = |mode: Checked<WrappingMode>| match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        _ => Wrap::Repeat,
    };
    Ok(Some(TextureRef {
        texture: wanted.index(image, usage.encoding, usage.make),
        uv_set: place as u32,
        wrap: sampler.map_or([Wrap::Repeat; 2], |s| [wrap(s.wrap_s), wrap(s.wrap_t)]),
        nearest: sampler.is_some_and(|s| matches!(s.mag_filter, Some(Checked::Valid(MagFilter::Nearest)))),
        transform: None,
    }))
}

fn slot_of(source: Source, at: &str, usage: &Use) -> Result<Slot, SceneError> {
    let mut slot = Slot { set: usage.set, transform: IDENTITY };
    let Some(transform) = &usage.transform else { return Ok(slot) };
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
