//! Links the board firmware: where `memory.x` is, and which linker scripts to use. Host builds are not affected.
//!
//! Here rather than in `.cargo/config.toml`, so that nobody's RUSTFLAGS can take them away.

fn main() {
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=build.rs");
    let is_board = std::env::var_os("CARGO_FEATURE_BOARD").is_some()
        && std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none");
    if let (true, Ok(folder)) = (is_board, std::env::var("CARGO_MANIFEST_DIR")) {
        println!("cargo:rustc-link-search={folder}");
        for argument in ["-Tlink.x", "-Tdefmt.x", "--nmagic"] {
            println!("cargo:rustc-link-arg-bin=firmware={argument}");
        }
    }
}
