//! Which cells, in which order, resumed from where: profiles, plan, executor, journal.
