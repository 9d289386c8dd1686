//! A quote's irradiance caches as text.

use forelight_protocol::words::counted;
use forelight_protocol::{CachePrice, CacheQuote, SharedCacheForecast};
use forelight_terminal::quantities::{count, money, seconds};

/// One cache for all frames or one for each, the reason, and both prices.
pub fn ways(cache: &CacheQuote) -> String {
    let said = |price: &CachePrice| {
        let cost = price.cost.map_or(String::new(), |cost| format!(", {}", money(cost.0)));
        let (records, work) = (count(price.records as f64), count(price.work));
        format!("{records} records, {work} operations, {} CPU time{cost}", seconds(price.cpu_seconds))
    };
    let way = if cache.shared { "one for all frames" } else { "one for each frame" };
    let mut text = format!("caches     {way}: {}\n", cache.reason);
    if let Some(shared) = &cache.shared_price {
        text += &format!(
            "           shared: {}; one for each frame: {}\n",
            said(shared),
            said(&cache.private_price)
        );
    }
    text
}

/// The shared cache, made before the frames. Without a newline.
pub fn shared(cache: &SharedCacheForecast) -> String {
    let parts = counted(cache.parts, "part");
    let cpu = seconds(cache.cpu_seconds.mean);
    format!("cache      {cpu} CPU time forecast in {parts}, before the frames")
}
