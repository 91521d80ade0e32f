//! Binds Embree 4 (bindgen), compiles the C++ in `cpp/` (cxx) and tells the linker where Embree is.
//!
//! Embree is looked for in `$EMBREE_DIR`, then in `.deps/embree4` (made by `scripts/setup.sh` on Debian 12), then
//! in the system (Debian 13 and later: package `libembree-dev`).

use std::env;
use std::path::{Path, PathBuf};

#[path = "build/native.rs"]
mod native;
#[path = "build/revision.rs"]
mod revision;

/// Files with a `#[cxx::bridge]`.
const BRIDGES: &[&str] = &[
    "src/ffi/isa.rs",
    "src/ffi/splat/loss.rs",
    "src/ffi/splat/rasterize.rs",
    "src/ffi/splat/bin.rs",
    "src/ffi/splat/image.rs",
    "src/ffi/trace/tracer.rs",
];

/// C++ compiled once, for the baseline x86-64.
const SOURCES: &[&str] = &[
    "cpp/common/isa.cpp",
    "cpp/splat/loss.cpp",
    "cpp/splat/rasterize.cpp",
    "cpp/splat/bin.cpp",
    "cpp/splat/image.cpp",
    "cpp/trace/coat.cpp",
    "cpp/trace/traced_mesh.cpp",
    "cpp/trace/tracer.cpp",
    "cpp/trace/wall_material.cpp",
];

/// The kernels, compiled once per instruction set.
const KERNELS: &[&str] = &[
    "cpp/splat/loss_kernel.cpp",
    "cpp/trace/noise_kernel.cpp",
    "cpp/splat/chain.cpp",
    "cpp/splat/disc.cpp",
    "cpp/splat/kernel.cpp",
    "cpp/splat/project.cpp",
];

/// The instruction sets: (namespace in C++, what the compiler may use). Which one runs is
/// decided on the user's machine (`cpp/common/isa.cpp`).
const INSTRUCTION_SETS: &[(&str, &[&str])] = &[
    ("baseline", &["-msse2"]),
    ("avx2", &["-mavx2", "-mfma"]),
    ("avx512", &["-mavx512f", "-mavx512vl", "-mavx512dq", "-mavx512bw", "-mprefer-vector-width=512"]),
];

fn main() {
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let prefix = embree_prefix(&root);
    if native::is_inner_call() {
        bind_embree(prefix.as_deref(), &out);
        compile_cpp(prefix.as_deref());
        compile_kernels();
        link_embree(prefix.as_deref());
        return;
    }
    let mut native_sources = vec![root.join("cpp"), root.join("build.rs")];
    native_sources.extend(BRIDGES.iter().map(|bridge| root.join(bridge)));
    let compiler = ["CXX", "CXXFLAGS"].map(env::var_os);
    // With the folder: what the native part said names it, and a copied target folder must not link another's C++.
    native::once(&format!("{} {prefix:?} {compiler:?} {}", revision::of(&native_sources), out.display()), &out);
    name_compiler();
    revision::tell(&root);
    println!("cargo:rerun-if-changed=cpp");
    println!("cargo:rerun-if-env-changed=EMBREE_DIR");
}

/// `doctor` tells which compiler built the program.
fn name_compiler() {
    let rustc = env::var_os("RUSTC").expect("cargo sets RUSTC");
    let answer = std::process::Command::new(rustc).arg("--version").output().expect("the compiler that runs this runs");
    println!("cargo:rustc-env=RESPIRE_BENCH_RUSTC={}", String::from_utf8_lossy(&answer.stdout).trim());
}

fn embree_prefix(root: &Path) -> Option<PathBuf> {
    if let Some(dir) = env::var_os("EMBREE_DIR").filter(|d| !d.is_empty()) {
        return Some(PathBuf::from(dir));
    }
    let local = root.join(".deps/embree4");
    // A path that does not exist would run this script at every build.
    if local.join(".ok").exists() {
        println!("cargo:rerun-if-changed={}", local.join(".ok").display());
        return local.canonicalize().ok();
    }
    None
}

fn bind_embree(prefix: Option<&Path>, out: &Path) {
    let header = prefix.map_or_else(|| PathBuf::from("/usr/include"), |p| p.join("include")).join("embree4/rtcore.h");
    assert!(
        header.exists(),
        "Embree 4 headers not found at {}: run scripts/setup.sh, or set EMBREE_DIR to a prefix with include/ and lib/",
        header.display()
    );
    let mut builder = bindgen::Builder::default()
        .header("cpp/trace/embree.h")
        .allowlist_function("rtc.*")
        .allowlist_type("RTC.*")
        .allowlist_var("RTC_.*")
        .default_enum_style(bindgen::EnumVariation::NewType { is_bitfield: false, is_global: false })
        .bitfield_enum("RTC.*Flags")
        .prepend_enum_name(false)
        .derive_default(true)
        .layout_tests(true)
        .generate_comments(false)
        .merge_extern_blocks(true);
    if let Some(prefix) = prefix {
        builder = builder.clang_arg(format!("-I{}", prefix.join("include").display()));
    }
    builder
        .generate()
        .expect("bindgen could not read Embree's headers")
        .write_to_file(out.join("embree.rs"))
        .expect("OUT_DIR is writable");
}

fn compile_cpp(prefix: Option<&Path>) {
    let mut build = cxx_build::bridges(BRIDGES);
    build.files(SOURCES).include(".").std("c++17").opt_level(3).flag("-Wall").flag("-Wextra");
    // Results must not depend on how the compiler contracts or reorders arithmetic.
    build.flag("-ffp-contract=off");
    if let Some(prefix) = prefix {
        build.include(prefix.join("include"));
    }
    build.compile("respire_bench_cpp");
    for file in BRIDGES {
        println!("cargo:rerun-if-changed={file}");
    }
}

fn compile_kernels() {
    for (namespace, flags) in INSTRUCTION_SETS {
        let mut build = cc::Build::new();
        build.cpp(true).files(KERNELS).include(".").std("c++17").opt_level(3);
        build.flag("-Wall").flag("-Wextra").define("RESPIRE_ISA", *namespace);
        // Forward and backward must take the same branches: no contraction except where it is written.
        build.flag("-ffp-contract=off").flag("-fno-math-errno").flag("-fno-trapping-math").flag("-fno-exceptions");
        // GCC 12 warns of the deliberately undefined operands in its own AVX-512 header.
        build.flag("-Wno-uninitialized").flag("-Wno-maybe-uninitialized");
        // No vector is passed from one file to another.
        build.flag("-Wno-psabi");
        for flag in *flags {
            build.flag(flag);
        }
        build.compile(&format!("respire_kernels_{namespace}"));
    }
}

fn link_embree(prefix: Option<&Path>) {
    if let Some(prefix) = prefix {
        let lib = prefix.join("lib");
        println!("cargo:rustc-link-search=native={}", lib.display());
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
    }
    println!("cargo:rustc-link-lib=dylib=embree4");
}
