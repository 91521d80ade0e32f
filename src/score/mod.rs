//! Metrics: registry, one file per family, protocol, aggregation. Reads folders; does not know how predictions were made.
