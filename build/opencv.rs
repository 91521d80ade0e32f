//! Warns where the `opencv` crate will not find OpenCV. Its own build fails then, and does not say what helps.

use std::env;
use std::process::Command;

/// One of these, or a package that pkg-config knows, leads the `opencv` crate to the library.
const VARIABLES: [&str; 7] = [
    "OPENCV_LINK_LIBS",
    "OPENCV_PACKAGE_NAME",
    "OPENCV_CMAKE_NAME",
    "OPENCV_CMAKE_BIN",
    "OpenCV_DIR",
    "CMAKE_PREFIX_PATH",
    "VCPKG_ROOT",
];

/// Prints the warning. Cargo does not hand `.cargo/config.toml` of this crate on to crates that depend on it.
pub fn warn_if_lost() {
    for variable in VARIABLES {
        println!("cargo:rerun-if-env-changed={variable}");
    }
    let named = VARIABLES.iter().any(|variable| env::var_os(variable).is_some());
    let known =
        |package: &&str| Command::new("pkg-config").args(["--exists", package]).status().is_ok_and(|s| s.success());
    if !named && !["opencv4", "opencv"].iter().any(known) {
        println!(
            "cargo:warning=OpenCV will not be found: copy the OPENCV_* lines of respire-bench's .cargo/config.toml into \
             your own, or install libopencv-dev, or depend on it with default-features = false (docs/BUILD.md)"
        );
    }
}
