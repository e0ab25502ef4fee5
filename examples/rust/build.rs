//! Makes Rust types of the published `.proto` files.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    println!("cargo::rerun-if-changed={root}/companion/proto/navigation.proto");
    let files = protox::compile(["companion/proto/navigation.proto"], [root])?;
    prost_build::compile_fds(files)?;
    Ok(())
}
