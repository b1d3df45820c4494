//! Typed reading of buffers, with every claim checked: offset + stride × (count − 1) + size ≤ view ≤ buffer, in u64.
//!
//! Integers that are `normalized` become max(c / (2^(b−1) − 1), −1) when signed and c / (2^b − 1) when not; other integers keep
//! their value. Sparse accessors replace single elements of a base, or of zeros.

use super::error::{SceneError, Source};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Root};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// The bytes of every buffer, each cut to its declared length, and what was decompressed.
pub(crate) struct Buffers<'a> {
    pub source: Source<'a>,
    pub root: &'a Root,
    /// Translations of nodes that lie far, in f64.
    pub far: &'a super::origin::Far,
    pub bytes: Vec<Cow<'a, [u8]>>,
    /// `[views]` what compressed buffer views hold; may be shorter than the file's list.
    pub views: Vec<Option<Vec<u8>>>,
    /// Elements of accessors that a Draco stream holds, tightly packed in the accessor's own type.
    pub accessors: BTreeMap<usize, Vec<u8>>,
}

/// Elements in a buffer view, or zeros.
#[derive(Clone, Copy)]
struct Elements<'a> {
    /// From the first element to the end of the view.
    bytes: &'a [u8],
    stride: usize,
    component: ComponentType,
}

struct Sparse<'a> {
    count: usize,
    indices: Elements<'a>,
    values: Elements<'a>,
}

/// A checked accessor.
pub(crate) struct View<'a> {
    source: Source<'a>,
    /// Index in the file, for messages.
    index: usize,
    /// Elements.
    pub count: usize,
    /// Components an element.
    pub lanes: usize,
    /// Type of a component.
    pub component: ComponentType,
    normalized: bool,
    base: Option<Elements<'a>>,
    sparse: Option<Sparse<'a>>,
}

impl<'a> Buffers<'a> {
    /// The bytes of a buffer view, decompressed.
    pub fn view(&self, index: usize) -> Result<&[u8], SceneError> {
        let at = || format!("bufferViews[{index}]");
        if let Some(Some(decoded)) = self.views.get(index) {
            return Ok(decoded);
        }
        let view = self.root.buffer_views.get(index).ok_or_else(|| self.source.invalid(at(), "does not exist"))?;
        self.range(view.buffer.value(), view.byte_offset.map_or(0, |o| o.0), view.byte_length.0, &at())
    }

    /// Bytes of a buffer.
    pub fn range(&self, buffer: usize, start: u64, length: u64, at: &str) -> Result<&[u8], SceneError> {
        let buffer: &[u8] = self.bytes.get(buffer).ok_or_else(|| self.source.invalid(at, "its buffer does not exist"))?;
        match start.checked_add(length) {
            Some(end) if end <= buffer.len() as u64 => Ok(&buffer[start as usize..end as usize]),
            _ => {
                let what = format!("bytes {start} + {length} reach beyond the buffer's {}", buffer.len());
                Err(self.source.invalid(at, what))
            }
        }
    }

    /// Checks an accessor against its views and buffers.
    pub fn accessor(&self, index: usize) -> Result<View<'_>, SceneError> {
        let at = || format!("accessors[{index}]");
        let invalid = |what: &str| self.source.invalid(at(), what);
        let accessor: &Accessor = self.root.accessors.get(index).ok_or_else(|| invalid("does not exist"))?;
        let (Checked::Valid(component), Checked::Valid(kind)) = (accessor.component_type, &accessor.type_) else {
            return Err(invalid("a component type or type that glTF does not have"));
        };
        let (component, kind) = (component.0, *kind);
        if matches!(kind, Type::Mat2 | Type::Mat3 | Type::Mat4) && component.size() < 4 {
            // Such columns are padded to 4 bytes; no attribute that we read is a matrix.
            return Err(self.source.unsupported(at(), "a matrix of small integers", "store it as floats"));
        }
        let lanes = kind.multiplicity();
        let count = accessor.count.0;
        if count > u64::from(u32::MAX) {
            return Err(invalid(&format!("{count} elements: more than any index can name")));
        }
        let base = match (self.accessors.get(&index), accessor.buffer_view) {
            // Its length was made from this very accessor.
            (Some(bytes), _) => Some(Elements { bytes, stride: component.size() * lanes, component }),
            (None, None) => None,
            (None, Some(view)) => {
                Some(self.elements(&at(), view.value(), accessor.byte_offset.map_or(0, |o| o.0), count, component, lanes, true)?)
            }
        };
        let sparse = match &accessor.sparse {
            None => None,
            Some(sparse) => {
                let Checked::Valid(narrow) = sparse.indices.component_type else {
                    return Err(invalid("sparse indices of a type that glTF does not have"));
                };
                if sparse.count.0 > count {
                    return Err(invalid(&format!("{} sparse elements in an accessor of {count}", sparse.count.0)));
                }
                let (i, v) = (&sparse.indices, &sparse.values);
                let place = format!("{}.sparse", at());
                let indices = self.elements(&place, i.buffer_view.value(), i.byte_offset.0, sparse.count.0, narrow.0, 1, false)?;
                let values = self.elements(&place, v.buffer_view.value(), v.byte_offset.0, sparse.count.0, component, lanes, false)?;
                Some(Sparse { count: sparse.count.0 as usize, indices, values })
            }
        };
        let normalized = accessor.normalized;
        Ok(View { source: self.source, index, count: count as usize, lanes, component, normalized, base, sparse })
    }

    fn elements(
        &self,
        at: &str,
        view: usize,
        offset: u64,
        count: u64,
        component: ComponentType,
        lanes: usize,
        strided: bool,
    ) -> Result<Elements<'_>, SceneError> {
        let bytes = self.view(view)?;
        let size = (component.size() * lanes) as u64;
        let stride = match self.root.buffer_views[view].byte_stride {
            Some(stride) if strided && stride.0 != 0 => stride.0 as u64,
            _ => size,
        };
        if stride < size {
            return Err(self.source.invalid(at, format!("a stride of {stride} bytes for elements of {size}")));
        }
        // count < 2³², stride ≤ 2³²: the product fits u64 with room, the sums are checked.
        let extent = if count == 0 { Some(0) } else { (count - 1).checked_mul(stride).and_then(|n| n.checked_add(size)) };
        match extent.and_then(|extent| extent.checked_add(offset)) {
            Some(end) if end <= bytes.len() as u64 => {}
            _ => {
                let what = format!(
                    "{count} elements of {size} bytes, {stride} apart, from byte {offset}, reach beyond bufferViews[{view}] of {} bytes",
                    bytes.len()
                );
                return Err(self.source.invalid(at, what));
            }
        }
        let bytes = if count == 0 { &[] } else { &bytes[offset as usize..] };
        Ok(Elements { bytes, stride: stride as usize, component })
    }
}

impl Elements<'_> {
    fn bytes_at(&self, element: usize, lane: usize) -> &[u8] {
        &self.bytes[element * self.stride + lane * self.component.size()..]
    }

    fn integer(&self, element: usize, lane: usize) -> i64 {
        let b = self.bytes_at(element, lane);
        match self.component {
            ComponentType::I8 => i64::from(b[0] as i8),
            ComponentType::U8 => i64::from(b[0]),
            ComponentType::I16 => i64::from(i16::from_le_bytes([b[0], b[1]])),
            ComponentType::U16 => i64::from(u16::from_le_bytes([b[0], b[1]])),
            ComponentType::U32 => i64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            ComponentType::F32 => unreachable!("floats are read by `float`"),
        }
    }

    fn float(&self, element: usize, lane: usize, normalized: bool) -> f32 {
        if self.component == ComponentType::F32 {
            let b = self.bytes_at(element, lane);
            return f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        }
        let value = self.integer(element, lane);
        let largest = match self.component {
            ComponentType::I8 => 127.0,
            ComponentType::U8 => 255.0,
            ComponentType::I16 => 32767.0,
            ComponentType::U16 => 65535.0,
            ComponentType::U32 | ComponentType::F32 => u32::MAX as f64,
        };
        if normalized { ((value as f64 / largest) as f32).max(-1.0) } else { value as f32 }
    }
}

impl View<'_> {
    /// JSON path of the accessor.
    pub fn at(&self) -> String {
        format!("accessors[{}]", self.index)
    }

    /// All elements as floats. `always_normalized` treats integers as fractions whatever the file says (colours have no other
    /// meaning). Fails when the element has not N components or a value is not finite.
    pub fn floats<const N: usize>(&self, always_normalized: bool) -> Result<Vec<[f32; N]>, SceneError> {
        self.expect_lanes(N)?;
        let normalized = self.normalized || always_normalized;
        let read = |from: &Elements, element: usize| -> [f32; N] { std::array::from_fn(|lane| from.float(element, lane, normalized)) };
        let mut values: Vec<[f32; N]> = match &self.base {
            Some(base) => (0..self.count).map(|element| read(base, element)).collect(),
            None => vec![[0.0; N]; self.count],
        };
        self.replace(|values_from, from, to| values[to] = read(values_from, from))?;
        match values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            None => Ok(values),
            Some(element) => {
                let what = format!("element {element} is {:?}: not a finite number", values[element]);
                Err(self.source.invalid(self.at(), what))
            }
        }
    }

    /// All elements as indices.
    pub fn indices(&self) -> Result<Vec<u32>, SceneError> {
        self.expect_lanes(1)?;
        if !matches!(self.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) {
            return Err(self.source.invalid(self.at(), "indices are neither u8, u16 nor u32"));
        }
        let mut values: Vec<u32> = match &self.base {
            Some(base) => (0..self.count).map(|element| base.integer(element, 0) as u32).collect(),
            None => vec![0; self.count],
        };
        self.replace(|values_from, from, to| values[to] = values_from.integer(from, 0) as u32)?;
        Ok(values)
    }

    fn expect_lanes(&self, lanes: usize) -> Result<(), SceneError> {
        if self.lanes == lanes {
            return Ok(());
        }
        Err(self.source.invalid(self.at(), format!("{} components an element, expected {lanes}", self.lanes)))
    }

    /// Calls `put(values, from, to)` for each sparse element, in rising order of `to`.
    fn replace(&self, mut put: impl FnMut(&Elements, usize, usize)) -> Result<(), SceneError> {
        let Some(sparse) = &self.sparse else { return Ok(()) };
        let mut last = -1;
        for k in 0..sparse.count {
            let to = sparse.indices.integer(k, 0);
            if to <= last || to >= self.count as i64 {
                let what = format!("index {to} at {k}: not rising, or beyond {} elements", self.count);
                return Err(self.source.invalid(format!("{}.sparse.indices", self.at()), what));
            }
            last = to;
            put(&sparse.values, k, to as usize);
        }
        Ok(())
    }
}
