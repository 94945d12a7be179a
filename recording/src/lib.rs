//! Recordings and sessions: the Parquet and CSV files that every flexstage tool reads and writes.
