//! Workers give the asset of threads: as processes, on a Slurm that is acted, on a real one where it can be had; and refuse what makes no sense.
#![cfg(unix)]

mod acted_slurm;
#[path = "../support/command.rs"]
mod command;
mod processes;
mod room;
mod slurm;
mod worker;
