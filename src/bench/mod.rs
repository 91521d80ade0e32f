//! Which cells, in which order, resumed from where: profiles, plan, executor, cache, events. Does not know what
//! reports look like.
//!
//! ```text
//! profile + cases + methods + seeds -> Plan -> execute(Stages, Store) -> finished cells, each a folder
//! ```
//!
//! A cell is a pure function of its key (case, simulation settings, method, seed, revision of the code that makes it),
//! so a finished cell is never computed again, and an interrupted run is resumed by starting it again.

pub mod array_job;
pub mod catalogue;
pub mod claim;
pub mod environment;
pub mod evaluation;
pub mod event;
pub mod executor;
pub mod live;
pub mod live_poses;
pub mod pipeline;
pub mod plan;
pub mod profile;
pub mod revision;
pub mod stages;
pub mod store;
pub mod timing;
pub mod variant;

pub use catalogue::Catalogue;
pub use environment::Environment;
pub use event::{CacheUse, Event, Watcher};
pub use executor::{FinishedCell, Freshness, execute, execute_at_once, finished, is_filmed, is_finished};
pub use pipeline::{Pipeline, SeededMethod, Wishes, reconstruct_folder};
pub use plan::{Cell, Plan, Planned};
pub use profile::Profile;
pub use stages::Stages;
pub use store::{Store, Unusable};
pub use variant::{Ablations, Variant};
