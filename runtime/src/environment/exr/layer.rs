//! Layers of an OpenEXR file: which of them is the picture.
//!
//! A layer is what stands before the last dot of its channels' names, in files of several parts after the part's name. The one without a name
//! comes first, then `Combined`, `beauty` and `rgba`, as renderers call the picture, then the others as they stand in the file; colour
//! before luminance.

use ::exr::meta::attribute::ChannelList;
use ::exr::meta::header::Header;
use ::exr::prelude::Vec2;

use super::super::source::Source;
use super::HELP;
use crate::error::RuntimeError;

/// Names of the picture among passes, the likeliest first; in lower case.
const PICTURES: [&str; 3] = ["combined", "beauty", "rgba"];
/// Names that a message lists.
const LISTED: usize = 8;

/// Channel indices, in a header's list, of what makes a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channels {
    /// Red, green and blue; three times the same for luminance.
    Rgb([usize; 3]),
    /// (R − Y)/Y, Y and (B − Y)/Y.
    Chroma([usize; 3]),
}

impl Channels {
    pub(super) fn indices(self) -> [usize; 3] {
        match self {
            Channels::Rgb(indices) | Channels::Chroma(indices) => indices,
        }
    }
}

/// A layer with colour.
pub(super) struct Layer {
    pub(super) header: usize,
    pub(super) channels: Channels,
    /// Empty for the one without a name.
    name: String,
    is_grey: bool,
}

impl Layer {
    /// Smaller is likelier to be the picture.
    fn rank(&self) -> usize {
        let known = |part: &str| PICTURES.iter().position(|name| part.eq_ignore_ascii_case(name));
        let place = if self.name.is_empty() { Some(0) } else { self.name.split('.').find_map(known).map(|place| place + 1) };
        place.unwrap_or(PICTURES.len() + 1) + if self.is_grey { 100 } else { 0 }
    }

    fn shown(&self) -> String {
        if self.name.is_empty() { "the one without a name".to_owned() } else { format!("`{}`", shorten(&self.name)) }
    }
}

/// The layer asked for, else the likeliest, and what to say of the choice.
pub(super) fn choose(source: Source<'_>, headers: &[Header], asked: Option<&str>) -> Result<(Layer, Option<String>), RuntimeError> {
    let mut layers = all(headers);
    if layers.is_empty() {
        let names: Vec<String> = headers.iter().flat_map(|header| &header.channels.list).map(|channel| channel.name.to_string()).collect();
        return Err(source.error(format!("no layer has channels R, G, B or Y (it has {})", shorten(&names.join(", "))), HELP));
    }
    let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_owned();
    let best = match asked {
        Some(asked) => {
            let exact = layers.iter().position(|layer| layer.name.eq_ignore_ascii_case(asked));
            exact.or_else(|| layers.iter().position(|layer| last(&layer.name).eq_ignore_ascii_case(asked)))
        }
        None => layers.iter().enumerate().min_by_key(|(at, layer)| (layer.rank(), *at)).map(|(at, _)| at),
    };
    let Some(best) = best else {
        let what = format!("it has no layer `{}` with colour", shorten(asked.unwrap_or_default()));
        return Err(source.error(what, &format!("it has {}", list(&layers))));
    };
    let chosen = layers.remove(best);
    let note = (asked.is_none() && !layers.is_empty()).then(|| {
        format!("of its {} layers {} is read; layer = \"...\" chooses another: {}", layers.len() + 1, chosen.shown(), list(&layers))
    });
    Ok((chosen, note))
}

fn list(layers: &[Layer]) -> String {
    let names: Vec<String> = layers.iter().take(LISTED).map(Layer::shown).collect();
    let more = if layers.len() > LISTED { format!(" and {} more", layers.len() - LISTED) } else { String::new() };
    names.join(", ") + &more
}

/// A file's own words, at most 120 characters of them.
fn shorten(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(120).collect()
}

/// Every layer with colour, in the file's order.
fn all(headers: &[Header]) -> Vec<Layer> {
    let mut layers = Vec::new();
    for (header, meta) in headers.iter().enumerate() {
        let part = meta.own_attributes.layer_name.as_ref().map(|name| name.to_string()).filter(|_| headers.len() > 1).unwrap_or_default();
        let names: Vec<String> = meta.channels.list.iter().map(|channel| channel.name.to_string()).collect();
        let mut prefixes = vec![""];
        for prefix in names.iter().filter_map(|name| name.rfind('.').map(|dot| &name[..=dot])) {
            if !prefixes.contains(&prefix) {
                prefixes.push(prefix);
            }
        }
        for prefix in prefixes {
            let Some((channels, is_grey)) = pick(&meta.channels, &names, prefix) else { continue };
            let name: Vec<&str> = [part.as_str(), prefix.trim_end_matches('.')].into_iter().filter(|name| !name.is_empty()).collect();
            layers.push(Layer { header, channels, name: name.join("."), is_grey });
        }
    }
    layers
}

/// Channels behind a prefix: R, G and B, else Y with RY and BY, else Y alone. Upper or lower case.
fn pick(channels: &ChannelList, names: &[String], prefix: &str) -> Option<(Channels, bool)> {
    let index = |name: &str| names.iter().position(|known| known.strip_prefix(prefix).is_some_and(|rest| rest.eq_ignore_ascii_case(name)));
    let sampling = |index: usize| channels.list[index].sampling;
    let whole = |name: &str| index(name).filter(|index| sampling(*index) == Vec2(1, 1));
    let rgb = || Some((Channels::Rgb([whole("r")?, whole("g")?, whole("b")?]), false));
    let (ry, by) = (index("ry"), index("by"));
    let chroma = || {
        let (ry, by) = (ry?, by?);
        let is_known = sampling(ry) == sampling(by) && matches!(sampling(ry), Vec2(1, 1) | Vec2(2, 2));
        Some((Channels::Chroma([ry, whole("y")?, by]), false)).filter(|_| is_known)
    };
    // With RY or BY beside it, Y is not alone: the image has colour that would be lost.
    let grey = || whole("y").filter(|_| ry.is_none() && by.is_none()).map(|y| (Channels::Rgb([y; 3]), true));
    rgb().or_else(chroma).or_else(grey)
}
