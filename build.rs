//! Compiles the C++ in `cpp/` (cxx), lists the files that the program carries, and with the feature `trace` binds
//! Embree 4 (bindgen) and tells the linker where it is. Without `trace` only the C++ of the splat core is compiled.
//!
//! Embree is looked for in `$EMBREE_DIR`, then in `.deps/embree4` (made by `scripts/setup.sh` on Debian 12), then
//! in the system (Debian 13 and later: package `libembree-dev`).

use std::env;
use std::path::{Path, PathBuf};

#[path = "build/native.rs"]
mod native;
#[cfg(feature = "vision")]
#[path = "build/opencv.rs"]
mod opencv;
#[path = "build/revision.rs"]
mod revision;
#[path = "build/shipped.rs"]
mod shipped;

/// What is compiled for one part of the crate.
struct Part {
    /// Files with a `#[cxx::bridge]`.
    bridges: &'static [&'static str],
    /// C++ compiled once, for the baseline x86-64.
    sources: &'static [&'static str],
    /// The kernels, compiled once per instruction set.
    kernels: &'static [&'static str],
}

/// The splat core, and what all parts share.
const SPLAT: Part = Part {
    bridges: &["src/ffi/isa.rs", "src/ffi/splat/rasterize.rs", "src/ffi/splat/bin.rs", "src/ffi/splat/image.rs"],
    sources: &["cpp/common/isa.cpp", "cpp/splat/rasterize.cpp", "cpp/splat/bin.cpp", "cpp/splat/image.cpp"],
    // What takes longest to compile first, so that no compiler works alone in the end; then pairs (`kernel_files`) that
    // share no large function, since GCC inlines those that are called once.
    kernels: &["cpp/splat/project.cpp", "cpp/splat/disc.cpp", "cpp/splat/chain.cpp", "cpp/splat/kernel.cpp"],
};

/// The photometric loss, which the methods train with.
#[cfg(feature = "methods")]
const LOSS: Part = Part {
    bridges: &["src/ffi/splat/loss.rs"],
    sources: &["cpp/splat/loss.cpp"],
    kernels: &["cpp/splat/loss_kernel.cpp"],
};

/// The path tracer.
#[cfg(feature = "trace")]
const TRACE: Part = Part {
    bridges: &["src/ffi/trace/tracer.rs"],
    sources: &[
        "cpp/trace/coat.cpp",
        "cpp/trace/traced_mesh.cpp",
        "cpp/trace/tracer.cpp",
        "cpp/trace/wall_material.cpp",
    ],
    kernels: &["cpp/trace/noise_kernel.cpp"],
};

/// The parts of the crate that the features ask for.
const PARTS: &[Part] = &[
    SPLAT,
    #[cfg(feature = "methods")]
    LOSS,
    #[cfg(feature = "trace")]
    TRACE,
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
        #[cfg(feature = "trace")]
        bind_embree(prefix.as_deref(), &out);
        compile_cpp(prefix.as_deref());
        compile_kernels(&out);
        #[cfg(feature = "trace")]
        link_embree(prefix.as_deref());
        return;
    }
    #[cfg(feature = "vision")]
    opencv::warn_if_lost();
    let mut native_sources = vec![root.join("cpp"), root.join("build.rs")];
    native_sources.extend(of_parts(|part| part.bridges).map(|bridge| root.join(bridge)));
    let compiler = ["CXX", "CXXFLAGS"].map(env::var_os);
    // With the folder: what the native part said names it, and a copied target folder must not link another's C++.
    let cpp = version_of_cpp();
    native::once(&format!("{} {prefix:?} {compiler:?} {cpp} {}", revision::of(&native_sources), out.display()), &out);
    revision::tell(&root, &[name_compiler(), cpp], &version_headers(prefix.as_deref()));
    shipped::list(&root, &out);
    println!("cargo:rerun-if-changed=cpp");
    // Without the path tracer nothing asks for it, and whoever builds the library must not do so again for it.
    #[cfg(feature = "trace")]
    println!("cargo:rerun-if-env-changed=EMBREE_DIR");
}

/// `doctor` tells which compiler built the program.
fn name_compiler() -> String {
    let rustc = env::var_os("RUSTC").expect("cargo sets RUSTC");
    let answer = std::process::Command::new(rustc).arg("--version").output().expect("the compiler that runs this runs");
    let name = String::from_utf8_lossy(&answer.stdout).trim().to_owned();
    println!("cargo:rustc-env=RESPIRE_BENCH_RUSTC={name}");
    name
}

/// What the C++ compiler calls itself.
fn version_of_cpp() -> String {
    let compiler = cc::Build::new().cpp(true).cargo_metadata(false).get_compiler();
    let answer = compiler.to_command().arg("--version").output().expect("the compiler that built the kernels runs");
    String::from_utf8_lossy(&answer.stdout).lines().next().unwrap_or_default().to_owned()
}

/// Headers that hold the versions of the libraries whose code makes films and scores.
fn version_headers(prefix: Option<&Path>) -> Vec<PathBuf> {
    let embree = prefix.map_or_else(|| PathBuf::from("/usr/include"), |p| p.join("include"));
    vec![embree.join("embree4/rtcore_config.h"), PathBuf::from("/usr/include/opencv4/opencv2/core/version.hpp")]
}

fn of_parts(files: impl Fn(&Part) -> &'static [&'static str]) -> impl Iterator<Item = &'static str> {
    PARTS.iter().flat_map(move |part| files(part).iter().copied())
}

/// Nothing but the methods asks for the kernels of velocities.
fn define_directions(build: &mut cc::Build) {
    if cfg!(feature = "methods") {
        build.define("RESPIRE_DIRECTIONS", None);
    }
}

/// The kernels as they are compiled: without velocities two by two, since reading the compiler's headers takes as long as
/// compiling a small one. With velocities such a file would be so large that GCC inlines less.
fn kernel_files(out: &Path) -> Vec<PathBuf> {
    let kernels: Vec<_> = of_parts(|part| part.kernels).collect();
    if cfg!(feature = "methods") {
        return kernels.iter().map(PathBuf::from).collect();
    }
    let join = |(k, pair): (usize, &[&str])| {
        let path = out.join(format!("kernels_{k}.cpp"));
        let text: String = pair.iter().map(|kernel| format!("#include \"{kernel}\"\n")).collect();
        std::fs::write(&path, text).expect("OUT_DIR is writable");
        path
    };
    kernels.chunks(2).enumerate().map(join).collect()
}

/// The folder that holds Embree's `include/` and `lib/`; `None` for the system's, and where nothing traces rays.
fn embree_prefix(root: &Path) -> Option<PathBuf> {
    if !cfg!(feature = "trace") {
        return None;
    }
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

#[cfg(feature = "trace")]
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
    let mut build = cxx_build::bridges(of_parts(|part| part.bridges));
    build.files(of_parts(|part| part.sources)).include(".").std("c++17").opt_level(3).flag("-Wall").flag("-Wextra");
    // Results must not depend on how the compiler contracts or reorders arithmetic.
    build.flag("-ffp-contract=off");
    define_directions(&mut build);
    if let Some(prefix) = prefix {
        build.include(prefix.join("include"));
    }
    build.compile("respire_bench_cpp");
    for file in of_parts(|part| part.bridges) {
        println!("cargo:rerun-if-changed={file}");
    }
}

fn compile_kernels(out: &Path) {
    let files = kernel_files(out);
    for (namespace, flags) in INSTRUCTION_SETS {
        let mut build = cc::Build::new();
        build.cpp(true).files(&files).include(".").std("c++17").opt_level(3);
        build.flag("-Wall").flag("-Wextra").define("RESPIRE_ISA", *namespace);
        // Forward and backward must take the same branches: no contraction except where it is written.
        build.flag("-ffp-contract=off").flag("-fno-math-errno").flag("-fno-trapping-math").flag("-fno-exceptions");
        // GCC 12 warns of the deliberately undefined operands in its own AVX-512 header.
        build.flag("-Wno-uninitialized").flag("-Wno-maybe-uninitialized");
        // No vector is passed from one file to another.
        build.flag("-Wno-psabi");
        define_directions(&mut build);
        for flag in *flags {
            build.flag(flag);
        }
        build.compile(&format!("respire_kernels_{namespace}"));
    }
}

#[cfg(feature = "trace")]
fn link_embree(prefix: Option<&Path>) {
    // Beside the program first, so that a folder with both can be moved (scripts/package.sh).
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN:$ORIGIN/lib");
    if let Some(prefix) = prefix {
        let lib = prefix.join("lib");
        println!("cargo:rustc-link-search=native={}", lib.display());
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
    }
    println!("cargo:rustc-link-lib=dylib=embree4");
}
