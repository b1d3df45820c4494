//! What can be seen from where, cut for keys: which geometry may change what a patch sees, and what an edit reaches.
//!
//! | file | what |
//! |---|---|
//! | [`layer`] | big occluders first: the order in which objects block |
//! | [`pieces`] | at most 256 triangles of one object and layer |
//! | [`shaft`] | the cells of directions that a box reaches from a box |
//! | [`tile`] | a 96th of the directions of a patch, and its row of a record |
//! | [`key`] | names of points and tiles in the ledger |
//! | [`snapshot`] | what blocked light when a record was made |
//! | [`seen`] | what the patches of an object saw, and all that this could depend on |
//! | [`changes`], [`edit`] | what differs between two scenes, and the occluders of the difference |

pub mod changes;
pub mod edit;
pub mod key;
pub mod layer;
pub mod pieces;
pub mod seen;
pub mod shaft;
pub mod snapshot;
pub mod tile;
