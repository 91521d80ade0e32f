//! Revisions of the code itself, room by room: `build.rs` hashes the sources of every room (comments and tests left
//! out), as "kernels" the C++ of the splat core with its bridges, as "tracer" all other C++ and bridges, and as
//! "outside" the build, the locked versions of the dependencies, the compilers with their flags, and Embree and OpenCV.

use super::hash;

/// Makes `room_revision(name)` from the hashes that `build.rs` hands over.
macro_rules! rooms {
    ($($room:literal => $variable:literal,)+) => {
        fn room_revision(room: &str) -> &'static str {
            match room {
                $($room => env!($variable),)+
                _ => unreachable!("build.rs hashes every room that is asked for"),
            }
        }
    };
}

rooms! {
    "base" => "RESPIRE_BENCH_REVISION_BASE",
    "formats" => "RESPIRE_BENCH_REVISION_FORMATS",
    "airway" => "RESPIRE_BENCH_REVISION_AIRWAY",
    "ct" => "RESPIRE_BENCH_REVISION_CT",
    "render" => "RESPIRE_BENCH_REVISION_RENDER",
    "simulate" => "RESPIRE_BENCH_REVISION_SIMULATE",
    "splat" => "RESPIRE_BENCH_REVISION_SPLAT",
    "reconstruct" => "RESPIRE_BENCH_REVISION_RECONSTRUCT",
    "score" => "RESPIRE_BENCH_REVISION_SCORE",
    "experiments" => "RESPIRE_BENCH_REVISION_EXPERIMENTS",
    "kernels" => "RESPIRE_BENCH_REVISION_KERNELS",
    "tracer" => "RESPIRE_BENCH_REVISION_TRACER",
    "outside" => "RESPIRE_BENCH_REVISION_OUTSIDE",
}

/// Of several rooms together, 64 hex digits. A room that no build script hashes is a bug.
pub fn of_rooms(rooms: &[&str]) -> String {
    let parts: Vec<&str> = rooms.iter().map(|room| room_revision(room)).collect();
    hash::of_bytes(parts.join(" ").as_bytes())
}
