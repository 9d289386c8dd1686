//! Pictures as SVG: the track record, and how a job's estimate moved.

mod chart;
mod history;
mod track_record;

pub(crate) use history::forecast_history;
pub(crate) use track_record::track_record;
