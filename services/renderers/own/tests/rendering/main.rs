//! Tasks and quotes of our renderer.

mod cached;
mod divided;
mod division_farm;
mod kept;
mod part_costs;
mod passes;
mod quotes;
mod room;
mod sharing;
mod tasks;
