//! The `prelight` command.

fn main() {
    eprintln!("prelight");
}
