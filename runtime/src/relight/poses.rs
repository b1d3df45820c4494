//! Where objects are drawn: meshes of what moves, brought into the world.

use crate::asset::Asset;
use crate::chunk::mesh::Mesh;
use crate::square_light::Pose;

/// Poses of an asset's objects.
#[derive(Debug, Default)]
pub struct Poses {
    /// `[objects]`; `None`: its mesh is in the world.
    posed: Vec<Option<Posed>>,
}

/// A mesh in the world.
#[derive(Debug)]
struct Posed {
    pose: Pose,
    position: Vec<[f32; 3]>,
    normal: Vec<[f32; 3]>,
    tangent: Vec<[f32; 4]>,
}

impl Posed {
    fn new(mesh: &Mesh, pose: Pose) -> Posed {
        let mut posed = Posed { pose, position: Vec::new(), normal: Vec::new(), tangent: Vec::new() };
        posed.fill(mesh);
        posed
    }

    fn fill(&mut self, mesh: &Mesh) {
        let Posed { pose, position, normal, tangent } = self;
        position.clear();
        position.extend(mesh.position.iter().map(|p| pose.place(*p)));
        normal.clear();
        normal.extend(mesh.normal.iter().map(|n| pose.direction(*n)));
        tangent.clear();
        tangent.extend(mesh.tangent.iter().map(|t| {
            let [x, y, z] = pose.direction([t[0], t[1], t[2]]);
            [x, y, z, t[3]]
        }));
    }
}

impl Poses {
    /// Where the scene has them.
    pub(super) fn new(asset: &Asset) -> Poses {
        let posed =
            |(i, object): (usize, &crate::asset::AssetObject)| object.moves.as_ref().map(|moves| Posed::new(&asset.mesh(i), moves.pose));
        Poses { posed: asset.objects().iter().enumerate().map(posed).collect() }
    }

    /// Puts an object that moves elsewhere.
    pub(super) fn place(&mut self, asset: &Asset, object: usize, pose: Pose) {
        if let Some(posed) = self.posed[object].as_mut().filter(|posed| posed.pose != pose) {
            posed.pose = pose;
            posed.fill(&asset.mesh(object));
        }
    }

    /// The pose of an object that moves.
    pub fn of(&self, object: usize) -> Option<&Pose> {
        self.posed.get(object)?.as_ref().map(|posed| &posed.pose)
    }

    /// Triangles of an object, in the world.
    pub fn mesh<'a>(&'a self, asset: &'a Asset, object: usize) -> Mesh<'a> {
        let mesh = asset.mesh(object);
        match self.posed.get(object).and_then(Option::as_ref) {
            Some(posed) => Mesh { position: &posed.position, normal: &posed.normal, tangent: &posed.tangent, ..mesh },
            None => mesh,
        }
    }
}
