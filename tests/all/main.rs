//! One binary of integration tests, so that they link once.
#![allow(clippy::unwrap_used, reason = "every function here belongs to a test")]

mod all_cases;
mod binary;
mod blind;
mod cases;
mod cheats;
mod clinical;
mod command_line;
mod export;
mod faults;
mod gate;
mod import;
mod import_ct;
mod layering;
mod many_films;
mod mesh_damage;
mod moved;
mod own_tracer;
mod picture_statistics;
mod ranges;
mod readers;
mod reference;
mod render;
mod render_command;
mod render_convergence;
mod render_noise;
mod render_subsurface;
mod render_vertices;
mod scope;
mod sequence_folder;
mod simulate;
mod simulate_ct;
mod splat;
mod third_parties;
mod track;
mod truth_maps;
