//! What commands print: tables, units, progress bars, and the files that they write.
