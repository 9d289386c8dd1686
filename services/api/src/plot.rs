//! SVG pictures: the track record, and a job's estimate over time.

mod chart;
mod history;
mod track_record;

pub(crate) use history::forecast_history;
pub(crate) use track_record::track_record;
