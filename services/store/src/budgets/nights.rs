//! Forecasts of nights.

use forelight_protocol::{BudgetForecast, Timestamp};

use crate::columns::Json;
use crate::database::Store;
use crate::error::Result;
use crate::writing::run;

/// A night that was forecast.
#[derive(Clone, PartialEq, Debug)]
pub struct KeptNight {
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
    /// The forecast.
    pub forecast: BudgetForecast,
}

impl Store {
    /// Keeps the forecast of a night. A later forecast replaces it until the middle of the night. There is
    /// one row per night, however often this is called.
    pub async fn keep_budget_forecast(&self, night: &KeptNight) -> Result<()> {
        let mut write = self.write().await?;
        let middle = night.from.plus_micros(night.until.micros_since(night.from) / 2);
        run!(
            write,
            "INSERT INTO budget_forecasts (date, zone, begin_at, end_at, made_at, body) \
             VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT (date, zone) DO UPDATE \
             SET made_at = excluded.made_at, body = excluded.body WHERE ?5 < ?7",
            night.forecast.date.to_string(),
            night.forecast.zone,
            night.from.micros(),
            night.until.micros(),
            night.forecast.made_at.micros(),
            Json(&night.forecast),
            middle.micros()
        );
        self.commit(write).await
    }

    /// The nights of a zone that were forecast and begin before an instant, newest first, at most `limit`.
    pub async fn budget_forecasts_before(
        &self,
        zone: &str,
        before: Timestamp,
        limit: u32,
    ) -> Result<Vec<KeptNight>> {
        Ok(sqlx::query_as!(
            KeptNight,
            "SELECT begin_at AS \"from\", end_at AS until, body AS forecast FROM budget_forecasts \
             WHERE zone = ? AND begin_at < ? ORDER BY begin_at DESC LIMIT ?",
            zone,
            before.micros(),
            limit
        )
        .fetch_all(self.readers())
        .await?)
    }
}
