//! The benches behind `forelight bench`, and what only they need.
