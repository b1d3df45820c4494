//! The same asset from workers: processes, a Slurm that is acted, a real one where it can be had; and what a worker is told that makes no sense.
#![cfg(unix)]

mod acted_slurm;
#[path = "../support/command.rs"]
mod command;
mod processes;
mod room;
mod slurm;
mod worker;
