//! Checks of node registrations and of changes by operators.

use forelight_protocol::{
    Capabilities, MOST_WINDOWS, Money, NodeCalendar, NodeCalibration, NodeChange, NodeRegistration,
    NodeTerms, ProblemKind,
};

use crate::error::{ApiError, ApiResult, WRONG_ROLE};
use crate::resources::checks::check_name;

/// Most renderers of a node.
const MOST_RENDERERS: usize = 50;

pub(super) fn check_change(change: &NodeChange) -> ApiResult<()> {
    change.speed.flatten().map_or(Ok(()), |speed| check_speed("/speed", speed))?;
    change.price_per_hour.flatten().map_or(Ok(()), |price| check_price("/price_per_hour", price))?;
    change
        .schedule
        .as_ref()
        .and_then(Option::as_ref)
        .map_or(Ok(()), |schedule| check_schedule("/schedule", schedule))?;
    change.terms.as_ref().map_or(Ok(()), check_terms)
}

/// Refuses what only an operator may change: what a node costs, how fast it is said to be, its terms, and
/// whether it is trusted again.
pub(super) fn check_own_change(change: &NodeChange) -> ApiResult<()> {
    let refused = [
        ("/price_per_hour", change.price_per_hour.is_some()),
        ("/speed", change.speed.is_some()),
        ("/terms", change.terms.is_some()),
        ("/set_aside", change.set_aside == Some(false)),
    ];
    match refused.into_iter().find(|(_, is_changed)| *is_changed) {
        Some((field, _)) => {
            let reason = "only an operator may change this; a worker's token may not";
            Err(ApiError::new(ProblemKind::Forbidden, reason).authenticate(WRONG_ROLE).at(field))
        }
        None => Ok(()),
    }
}

/// Checks a node's registration. `place` is the JSON pointer to it.
pub(super) fn check_registration(place: &str, node: &NodeRegistration) -> ApiResult<()> {
    let at = |name: &str| format!("{place}/{name}");
    check_name(&at("name"), &node.name, 100)?;
    check_speed(&at("speed"), node.speed)?;
    check_price(&at("price_per_hour"), node.price_per_hour)?;
    if !(1..=4096).contains(&node.cores) {
        return Err(ApiError::invalid(at("cores"), "a node has 1 to 4096 cores"));
    }
    let Capabilities {
        memory_bytes,
        processor,
        vulkan_adapter,
        gpu: _,
        renderers,
        ffmpeg,
        denoiser,
        calibration,
        version,
    } = &node.capabilities;
    if memory_bytes.is_some_and(|bytes| i64::try_from(bytes).is_err()) {
        return Err(ApiError::invalid(at("capabilities/memory_bytes"), "a number larger than 2⁶³ − 1"));
    }
    node.schedule.as_ref().map_or(Ok(()), |schedule| check_schedule(&at("schedule"), schedule))?;
    for (name, text) in [("processor", processor), ("vulkan_adapter", vulkan_adapter)] {
        text.as_ref().map_or(Ok(()), |text| check_name(&at(&format!("capabilities/{name}")), text, 200))?;
    }
    for (name, text) in [("version", version), ("ffmpeg", ffmpeg), ("denoiser", denoiser)] {
        text.as_ref().map_or(Ok(()), |text| {
            check_name(&at(&format!("capabilities/{name}")), text, Capabilities::LONGEST_VERSION)
        })?;
    }
    if renderers.len() > MOST_RENDERERS {
        let reason = format!("{} renderers; a node has at most {MOST_RENDERERS}", renderers.len());
        return Err(ApiError::invalid(at("capabilities/renderers"), reason));
    }
    for (i, renderer) in renderers.iter().enumerate() {
        renderer.check().map_err(|(field, reason)| {
            ApiError::invalid(at(&format!("capabilities/renderers/{i}/{field}")), reason)
        })?;
    }
    let checked = calibration.as_ref().map_or(Ok(()), NodeCalibration::check);
    checked.map_err(|(field, reason)| {
        ApiError::invalid(at(&format!("capabilities/calibration/{field}")), format!("{field} {reason}"))
    })
}

fn check_schedule(pointer: &str, schedule: &NodeCalendar) -> ApiResult<()> {
    schedule.check().map_err(|(field, reason)| ApiError::invalid(format!("{pointer}/{field}"), reason))
}

fn check_terms(terms: &NodeTerms) -> ApiResult<()> {
    const WEEK: u32 = 7 * 86_400;
    for (field, seconds, most) in [
        ("billing_step_seconds", terms.billing_step_seconds, WEEK),
        ("minimum_booking_seconds", terms.minimum_booking_seconds, WEEK),
        ("setup_seconds", terms.setup_seconds, 86_400),
    ] {
        if seconds > most {
            return Err(ApiError::invalid(
                format!("/terms/{field}"),
                format!("at most {most} seconds are allowed"),
            ));
        }
    }
    if terms.maintenance.len() > MOST_WINDOWS {
        let reason = format!("a node has at most {MOST_WINDOWS} maintenance windows");
        return Err(ApiError::invalid("/terms/maintenance", reason));
    }
    match terms.maintenance.iter().position(|span| span.end.is_some_and(|end| end <= span.start)) {
        Some(wrong) => {
            Err(ApiError::invalid(format!("/terms/maintenance/{wrong}/end"), "it ends before it starts"))
        }
        None => Ok(()),
    }
}

fn check_speed(pointer: &str, speed: f64) -> ApiResult<()> {
    // This form also refuses a NaN.
    if (0.001..=1000.0).contains(&speed) {
        Ok(())
    } else {
        Err(ApiError::invalid(pointer, "a speed is 0.001 to 1000"))
    }
}

fn check_price(pointer: &str, price: Money) -> ApiResult<()> {
    /// A million units per hour. With this limit, no sum over a farm and a year overflows.
    const HIGHEST: Money = Money(1_000_000_000_000);
    if (Money(0)..=HIGHEST).contains(&price) {
        Ok(())
    } else {
        Err(ApiError::invalid(pointer, format!("a price is 0 to {} micro-units an hour", HIGHEST.0)))
    }
}
