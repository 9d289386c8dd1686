//! What was said of nights to come.

use forelight_protocol::{BudgetForecast, Timestamp};

use crate::database::Store;
use crate::decode::{json, time, to_json};
use crate::error::StoreError;

/// A night that was forecast.
#[derive(Clone, PartialEq, Debug)]
pub struct KeptNight {
    /// First instant.
    pub from: Timestamp,
    /// The instant after the last.
    pub until: Timestamp,
    /// What was said.
    pub forecast: BudgetForecast,
}

impl Store {
    /// Keeps what is said of a night, unless something was said before and the night is past its middle. One row a night, however often
    /// this is called.
    pub async fn keep_budget_forecast(&self, night: &KeptNight) -> Result<(), StoreError> {
        let mut write = self.write().await?;
        let middle = night.from.plus_micros(night.until.micros_since(night.from) / 2);
        sqlx::query(
            "INSERT INTO budget_forecasts (date, zone, begin_at, end_at, made_at, body) VALUES (?1, ?2, ?3, ?4, ?5, ?6) \
             ON CONFLICT (date, zone) DO UPDATE SET made_at = excluded.made_at, body = excluded.body WHERE ?5 < ?7",
        )
        .bind(night.forecast.date.to_string())
        .bind(&night.forecast.zone)
        .bind(night.from.micros())
        .bind(night.until.micros())
        .bind(night.forecast.made_at.micros())
        .bind(to_json(&night.forecast)?)
        .bind(middle.micros())
        .execute(write.connection().await?)
        .await?;
        self.commit(write).await
    }

    /// The nights of a zone that were forecast and begin before an instant, newest first, at most `limit`.
    pub async fn budget_forecasts_before(
        &self,
        zone: &str,
        before: Timestamp,
        limit: u32,
    ) -> Result<Vec<KeptNight>, StoreError> {
        let rows = sqlx::query(
            "SELECT * FROM budget_forecasts WHERE zone = ? AND begin_at < ? ORDER BY begin_at DESC LIMIT ?",
        )
        .bind(zone)
        .bind(before.micros())
        .bind(limit)
        .fetch_all(self.readers())
        .await?;
        rows.iter()
            .map(|row| {
                Ok(KeptNight {
                    from: time(row, "begin_at")?,
                    until: time(row, "end_at")?,
                    forecast: json(row, "body")?,
                })
            })
            .collect()
    }
}
