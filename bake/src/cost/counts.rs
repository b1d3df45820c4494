//! What was counted of objects before, so that a scene's edge length is found again without counting: an edit of materials or lights counts
//! nothing, an edit of one object that object alone.
//!
//! ```text
//! counts key   = H(versions, transform, per primitive: sides, arrays)      all that a count reads of an object but the knobs
//! record       data: version u8, then rows, ascending: H(knobs, limit) 16, points u64, triangles u64
//! ```
//!
//! A row is what [`crate::points::count::count_object`] says, to the number, so the search takes the same steps with and without it. Records are a cache.

use crate::error::{BakeError, PlanError};
use crate::mesh::PointParams;
use crate::mesh::weld::BaseMesh;
use crate::points::count::{PointCount, count_object_until, longest_edge};
use crate::reach::key::Hasher;
use prelight_manifests::Digest;
use prelight_scene::world::World;
use prelight_scene::{Primitive, Scene};
use prelight_store::{Record, Store, StoreError};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Mutex, OnceLock};

const VERSION: u8 = 1;
const ROW: usize = 16 + 8 + 8;

/// Rows of one object.
#[derive(Clone, Debug, Default)]
struct Rows {
    rows: BTreeMap<[u8; 16], PointCount>,
    has_new: bool,
}

/// Counts of a scene's objects, known and new.
#[derive(Debug, Default)]
pub struct Counts {
    /// `[objects]`.
    keys: Vec<Digest>,
    objects: Vec<Mutex<Rows>>,
    stop: Option<fn() -> bool>,
}

impl Counts {
    /// Counts of a scene; what a store knows, if there is one.
    ///
    /// # Errors
    /// What the store says.
    pub fn new(scene: &Scene, store: Option<&Store>) -> Result<Counts, StoreError> {
        let keys: Vec<Digest> = (0..scene.objects.len()).into_par_iter().map(|object| key(scene, object)).collect();
        let known = |key: &Digest| -> Result<Mutex<Rows>, StoreError> {
            let mut rows = BTreeMap::new();
            if let Some(store) = store {
                store.lookup_all(key)?.iter().filter_map(|record| decode(&record.data)).for_each(|found| rows.extend(found));
            }
            Ok(Mutex::new(Rows { rows, has_new: false }))
        };
        let objects = keys.iter().map(known).collect::<Result<_, _>>()?;
        Ok(Counts { keys, objects, stop: None })
    }

    /// Counts that end early once `stop` says so: figures are then of no use, are not kept, and whoever asked looks at `stop` as well.
    #[must_use]
    pub fn stopping(mut self, stop: fn() -> bool) -> Self {
        self.stop = Some(stop);
        self
    }

    /// Records what is new.
    ///
    /// # Errors
    /// What the store says.
    pub fn save(&self, store: &Store) -> Result<(), BakeError> {
        let mut writer = store.writer();
        let mut any = false;
        for (key, rows) in self.keys.iter().zip(&self.objects) {
            let mut rows = rows.lock().expect("no panic under this lock");
            if std::mem::take(&mut rows.has_new) {
                writer.record(*key, Record { chunks: Vec::new(), data: encode(&rows.rows) });
                any = true;
            }
        }
        if any {
            writer.commit()?;
        }
        Ok(())
    }

    fn row(&self, object: usize, name: [u8; 16], count: impl FnOnce() -> Option<PointCount>) -> PointCount {
        let Some(rows) = self.objects.get(object) else { return count().unwrap_or_default() };
        if let Some(known) = rows.lock().expect("no panic under this lock").rows.get(&name) {
            return *known;
        }
        let Some(counted) = count() else { return PointCount::default() };
        let mut rows = rows.lock().expect("no panic under this lock");
        rows.rows.insert(name, counted);
        rows.has_new = true;
        counted
    }
}

/// Objects to be counted; welded only where something of them is not known.
pub(crate) struct Counter<'a> {
    scene: &'a Scene,
    world: &'a World,
    counts: &'a Counts,
    welded: Vec<OnceLock<BaseMesh>>,
}

impl<'a> Counter<'a> {
    /// A counter of all objects of a scene.
    pub(crate) fn new(scene: &'a Scene, world: &'a World, counts: &'a Counts) -> Self {
        Counter { scene, world, counts, welded: (0..scene.objects.len()).map(|_| OnceLock::new()).collect() }
    }

    fn base(&self, object: usize) -> &BaseMesh {
        self.welded[object].get_or_init(|| BaseMesh::build(self.scene, self.world, object))
    }

    /// [`count_object_until`] of an object.
    pub(crate) fn count(&self, object: usize, params: &PointParams, enough: u64) -> PointCount {
        let stop = || self.counts.stop.is_some_and(|stop| stop());
        self.counts.row(object, name_of(params, enough), || count_object_until(self.base(object), params, enough, &stop))
    }

    /// Points before leaks are split.
    ///
    /// # Errors
    /// Knobs that make no sense, or too many triangles.
    pub(crate) fn points(&self, object: usize, params: &PointParams) -> Result<u64, PlanError> {
        params.check()?;
        let count = self.count(object, params, u64::from(params.max_triangles));
        if count.triangles > u64::from(params.max_triangles) {
            let name = self.scene.objects[object].name.clone();
            return Err(PlanError::TooManyTriangles { object: name, limit: params.max_triangles, edge_length: params.edge_length });
        }
        Ok(count.points)
    }

    /// `[objects]` points, however many.
    pub(crate) fn each(&self, params: &PointParams) -> Vec<u64> {
        (0..self.welded.len()).into_par_iter().map(|object| self.count(object, params, u64::MAX).points).collect()
    }

    /// The geometry that is counted.
    pub(crate) fn world(&self) -> &World {
        self.world
    }

    /// Points and triangles of all objects.
    pub(crate) fn total(&self, params: &PointParams, enough: u64) -> PointCount {
        self.total_where(params, enough, |_| true)
    }

    /// [`Counter::total`] of some objects.
    pub(crate) fn total_where(&self, params: &PointParams, enough: u64, keep: impl Fn(usize) -> bool + Sync) -> PointCount {
        let add = |a: PointCount, b: PointCount| PointCount {
            points: a.points.saturating_add(b.points),
            triangles: a.triangles.saturating_add(b.triangles),
        };
        let objects = (0..self.welded.len()).into_par_iter().filter(|object| keep(*object));
        objects.map(|object| self.count(object, params, enough)).reduce(PointCount::default, add)
    }

    /// Longest edge of all base meshes, metres.
    pub(crate) fn longest_edge(&self) -> f64 {
        let longest = |object: usize| {
            // The number's bits in the place of points.
            let name = Hasher::new("prelight longest edge").finish_short();
            let row = || Some(PointCount { points: longest_edge(self.base(object)).to_bits(), triangles: 0 });
            f64::from_bits(self.counts.row(object, name, row).points)
        };
        (0..self.welded.len()).into_par_iter().map(longest).reduce(|| 0.0, f64::max)
    }
}

/// Named one by one: a new knob must find its way into the name.
fn name_of(params: &PointParams, enough: u64) -> [u8; 16] {
    let PointParams { edge_length, normal_angle_deg, area_floor, max_level, coarser, quarters, max_shadow_gap, max_triangles } = *params;
    let mut hasher = Hasher::new("prelight count");
    hasher.floats(&[edge_length, normal_angle_deg, area_floor, max_shadow_gap]);
    hasher.words(&[max_level, u32::from(coarser) | u32::from(quarters) << 1, max_triangles]);
    hasher.bytes(&enough.to_le_bytes());
    hasher.finish_short()
}

fn key(scene: &Scene, object: usize) -> Digest {
    let source = &scene.objects[object];
    let mut hasher = Hasher::new("prelight counts");
    source.world_from_local.iter().for_each(|value| hasher.bytes(&value.to_le_bytes()));
    for primitive in &source.mesh.primitives {
        let material = scene.materials.get(primitive.material as usize);
        let (sides, set) = material.map_or((0, None), |material| (1 + u32::from(material.double_sided), material.tangent_uv_set()));
        hasher.words(&[sides, set.map_or(0, |set| 1 + set)]);
        hash_arrays(primitive, &mut hasher);
    }
    hasher.finish()
}

/// Vertices by their bits; what is left out is told from what is empty.
pub(crate) fn hash_arrays(primitive: &Primitive, hasher: &mut Hasher) {
    let Primitive { positions, triangles, material: _, normals, tangents, uvs, colors } = primitive;
    let optional: [Option<&[u8]>; 5] = [
        normals.as_deref().map(bytemuck::cast_slice),
        tangents.as_deref().map(bytemuck::cast_slice),
        uvs[0].as_deref().map(bytemuck::cast_slice),
        uvs[1].as_deref().map(bytemuck::cast_slice),
        colors.as_deref().map(bytemuck::cast_slice),
    ];
    for array in [Some(bytemuck::cast_slice(positions)), Some(bytemuck::cast_slice(triangles))].into_iter().chain(optional) {
        hasher.bytes(&array.map_or(u64::MAX, |array| array.len() as u64).to_le_bytes());
        hasher.bytes(array.unwrap_or_default());
    }
}

fn encode(rows: &BTreeMap<[u8; 16], PointCount>) -> Vec<u8> {
    let mut data = vec![VERSION];
    for (name, count) in rows {
        data.extend_from_slice(name);
        data.extend_from_slice(&count.points.to_le_bytes());
        data.extend_from_slice(&count.triangles.to_le_bytes());
    }
    data
}

/// `None` where it is none.
fn decode(data: &[u8]) -> Option<BTreeMap<[u8; 16], PointCount>> {
    let (version, rest) = data.split_first()?;
    let (rows, tail) = rest.as_chunks::<ROW>();
    let number = |row: &[u8; ROW], at: usize| u64::from_le_bytes(std::array::from_fn(|i| row[at + i]));
    let count = |row: &[u8; ROW]| PointCount { points: number(row, 16), triangles: number(row, 24) };
    let rows = rows.iter().map(|row| (std::array::from_fn(|i| row[i]), count(row)));
    (*version == VERSION && tail.is_empty()).then(|| rows.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::density::density_of;
    use crate::points::test_scenes::*;

    #[test]
    fn counts_from_a_store_are_those_that_are_counted_and_an_edited_object_is_counted_anew() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open_or_create(folder.path()).unwrap();
        let mut scene = scene();
        add(&mut scene, "ball", vec![sphere([1.0; 3], 0.8, 12, 8, false)], IDENTITY);
        add(&mut scene, "sheet", vec![quad([0.0; 3], [3.1, 0.0, 0.0], [0.0, 0.2, 2.2], 1)], IDENTITY);
        let ask = |scene: &Scene, store: Option<&Store>| {
            let (world, counts) = (World::build(scene), Counts::new(scene, store).unwrap());
            let found = density_of(&Counter::new(scene, &world, &counts), &params(1.0), None, 3000, false).unwrap();
            let new = counts.objects.iter().filter(|rows| rows.lock().unwrap().has_new).count();
            store.inspect(|store| counts.save(store).unwrap());
            (found, new)
        };
        let (expected, new) = ask(&scene, None);
        assert_eq!(new, 2, "nothing is known without a store");
        assert_eq!(ask(&scene, Some(&store)), (expected.clone(), 2));
        scene.materials[0].roughness = 0.125;
        assert_eq!(ask(&scene, Some(&store)), (expected, 0), "a factor counts nothing");
        scene.objects[1].world_from_local[0] = 1.5;
        let edited = ask(&scene, Some(&store));
        assert_eq!(edited, (ask(&scene, None).0, edited.1));
        assert!(edited.1 >= 1);
        scene.materials[1].double_sided ^= true;
        assert_eq!(ask(&scene, Some(&store)).0, ask(&scene, None).0, "sides are part of the key");
    }

    #[test]
    fn rows_come_back_and_strangers_are_refused() {
        let rows: BTreeMap<[u8; 16], PointCount> =
            (0..3u8).map(|i| ([i; 16], PointCount { points: u64::from(i) << 40, triangles: 7 })).collect();
        let data = encode(&rows);
        assert_eq!(decode(&data), Some(rows));
        assert!((0..data.len()).filter(|len| len % ROW != 1).all(|len| decode(&data[..len]).is_none()));
    }
}
