//! A real Slurm, where its programs can be had: three nodes on this machine, each a namespace of processes.
