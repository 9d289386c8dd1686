//! Farm descriptions: the example can be planned, and mistakes are named.

use forelight_planner::{Description, DescriptionError, Division, plan, verify};

const EXAMPLE: &str = include_str!("../farm.example.json");

fn described(text: &str) -> Description {
    serde_json::from_str(text).expect("a description")
}

#[test]
fn the_example_is_planned() {
    let input = described(EXAMPLE).input(jiff::tz::db()).expect("an input");
    assert_eq!((input.nodes.len(), input.jobs.len()), (30, 5));
    let found = plan(&input).expect("a plan");
    assert_eq!(verify(&input, &found), Ok(()));
    assert!(found.jobs.iter().all(|entry| entry.verdict.is_kept()), "{:?}", found.jobs);
    assert!(found.bookings.iter().filter(|booking| booking.job == 3).count() > 1, "the poster is divided");
    // Clocks go forward on 29 March. The desks are free all weekend, and that night has 11 hours.
    let desk = &input.nodes[8];
    assert_eq!(desk.name, "desk-1");
    let hours: Vec<i64> =
        desk.calendar.iter().map(|open| (open.end.expect("an end") - open.start) / 3_600_000_000).collect();
    assert_eq!(hours[0], 4 + 48 - 1, "from Friday 20:00 to Monday 00:00, less the hour that is left out");
}

#[test]
fn parts_are_a_limit_or_a_number() {
    let division = |fields: &str| {
        let text = format!(
            r#"{{ "now": "2026-03-27T18:00:00Z", "nodes": [{{ "name": "a", "price_per_hour": 1 }}],
                 "jobs": [{{ "name": "j", "frames": 1, "hours": 1{fields} }}] }}"#
        );
        let input = described(&text).input(jiff::tz::db())?;
        Ok((input.jobs[0].frames[0].division, input.jobs[0].part_overhead))
    };
    assert_eq!(division(""), Ok((Division::Whole, 0)));
    let overhead = r#", "parts": 8, "part_overhead_hours": 0.5"#;
    assert_eq!(division(overhead), Ok((Division::UpTo(8), 1_800_000_000_000)));
    assert_eq!(division(r#", "exact_parts": 3"#), Ok((Division::Into(3), 0)));
    let both: Result<_, DescriptionError> = division(r#", "exact_parts": 3, "parts": 8"#);
    assert!(both.is_err_and(|error| error.to_string().contains("set one of them")));
}

#[test]
fn frames_lie_on_nodes_with_the_memory_and_the_cores_that_their_job_needs() {
    let node = |name: &str, memory: u32, gpu: u32, cores: u32| {
        format!(
            r#"{{ "name": "{name}", "memory_gib": {memory}, "gpu_memory_gib": {gpu}, "cores": {cores}, "price_per_hour": {cores} }}"#
        )
    };
    let nodes =
        [node("small", 8, 0, 4), node("large", 64, 0, 8), node("many", 8, 0, 16), node("gpu", 64, 24, 32)];
    let needs = [
        ("anything", ""),
        ("memory", r#", "memory_gib": 9, "shared_cache_hours": 1"#),
        ("cores", r#", "cores": 9"#),
        ("gpu", r#", "gpu_memory_gib": 24"#),
        ("nothing", r#", "memory_gib": 65"#),
    ];
    let jobs = needs.map(|(name, need)| format!(r#"{{ "name": "{name}", "frames": 1, "hours": 1{need} }}"#));
    for (place, expected) in
        [Some("small"), Some("large"), Some("many"), Some("gpu"), None].into_iter().enumerate()
    {
        let text = format!(
            r#"{{ "now": "2026-03-27T18:00:00Z", "nodes": [{}], "jobs": [{}] }}"#,
            nodes.join(", "),
            jobs[place]
        );
        let input = described(&text).input(jiff::tz::db()).expect("an input");
        let found = plan(&input).expect("a plan");
        assert_eq!(verify(&input, &found), Ok(()));
        let name = |id: u64| input.nodes[id as usize].name.as_str();
        let on: Vec<&str> = found.bookings.iter().map(|booking| name(booking.node)).collect();
        assert!(
            on.iter().all(|&node| Some(node) == expected) && on.is_empty() == expected.is_none(),
            "{text}: {on:?}"
        );
    }
}

#[test]
fn frames_that_are_neither_a_count_nor_a_list_are_told_what_they_may_be() {
    let text = EXAMPLE.replace("\"frames\": 120", "\"frames\": -1");
    let error = serde_json::from_str::<Description>(&text).expect_err("no frames").to_string();
    assert!(error.contains("write how many there are"), "{error}");
}

#[test]
fn mistakes_are_named() {
    let error = |from: &str, to: &str| {
        assert!(EXAMPLE.contains(from), "{from}");
        described(&EXAMPLE.replace(from, to)).input(jiff::tz::db()).expect_err(to)
    };
    assert!(matches!(
        error("\"project\": \"otter\", \"frames\": 120", "\"project\": \"seal\", \"frames\": 120"),
        DescriptionError::Unknown { what: "project", .. }
    ));
    assert!(matches!(
        error("\"name\": \"water\"", "\"name\": \"hero-shot\""),
        DescriptionError::Twice { what: "job", .. }
    ));
    assert!(matches!(error("\"frames\": 120", "\"frames\": 1000000001"), DescriptionError::Value { .. }));
    assert!(matches!(error("\"setup\": \"10m\"", "\"setup\": \"soon\""), DescriptionError::Value { .. }));
    assert!(matches!(error("\"confidence\": 95", "\"confidence\": 99"), DescriptionError::Value { .. }));
    assert!(matches!(
        error("\"price_per_hour\": 0.40", "\"price_per_hour\": -1"),
        DescriptionError::Value { .. }
    ));
    assert!(matches!(
        error("Europe/Berlin", "Mars/Olympus"),
        DescriptionError::Unknown { what: "time zone", .. }
    ));
    let text = EXAMPLE.replace("\"mon\"", "\"monday\"");
    let wrong = serde_json::from_str::<Description>(&text).expect_err("no such day").to_string();
    assert!(wrong.contains("\"monday\" is not a day of the week"), "{wrong}");
    let unknown = EXAMPLE.replace("\"hours\": 0.3", "\"hours\": 0.3, \"colour\": 1");
    assert!(serde_json::from_str::<Description>(&unknown).is_err());
}
