//! What an older prelight wrote is read for ever: the store ([`store`]) and the asset ([`asset`]), one folder of `tests/compat` a version.

mod asset;
mod store;
