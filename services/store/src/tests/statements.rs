//! The statements that are checked at compile time, against the schema that the migrations make.

use sqlx::{AssertSqlSafe, Executor as _, SqlSafeStr as _};

use super::*;

/// What `.sqlx` holds of each statement.
fn prepared() -> Vec<serde_json::Value> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/.sqlx");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.map(|file| serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap()).collect()
}

fn text(prepared: &serde_json::Value) -> String {
    prepared["query"].as_str().unwrap().to_owned()
}

/// The texts of all statements that are checked.
pub(super) fn checked() -> Vec<String> {
    prepared().iter().map(text).collect()
}

#[tokio::test]
async fn what_is_known_of_each_statement_is_what_the_schema_says() {
    let farm = Farm::new().await;
    let mut connection = farm.store.readers().acquire().await.unwrap();
    for prepared in prepared() {
        let query = text(&prepared);
        let described =
            (&mut *connection).describe(AssertSqlSafe(query.clone()).into_sql_str()).await.unwrap();
        let described = serde_json::to_value(described).unwrap();
        assert_eq!(described, prepared["describe"], "run services/store/prepare.sh: {query}");
    }
}

#[test]
fn expressions_say_whether_they_can_be_null() {
    for prepared in prepared() {
        for column in prepared["describe"]["columns"].as_array().unwrap() {
            let name = column["name"].as_str().unwrap();
            // Of an expression, SQLite's word on that cannot be trusted. Counts are never NULL.
            let is_expression = column["origin"] == "Expression";
            let is_known = name.contains(['!', '?']) || name.starts_with("count(");
            // These rows are decoded by name where they are asked for.
            let is_asked =
                ["found", "one", "was_answered", "some_ran_out", "artifacts", "task_id", "has_calendar"];
            assert!(!is_expression || is_known || is_asked.contains(&name), "{name} of {}", text(&prepared));
        }
    }
}

#[tokio::test]
async fn no_statement_looks_for_a_job_among_all_jobs_of_a_plan() {
    let farm = Farm::new().await;
    for query in checked() {
        // Whether a plan has any job is found at once.
        let steps = claims::steps_of(&farm, &query).await;
        assert!(!steps.iter().any(|step| step.contains(" USING INDEX jobs_by_plan")), "{query}: {steps:?}");
    }
}

#[tokio::test]
async fn lists_and_sums_read_indexes_and_sort_nothing() {
    let farm = Farm::new().await;
    let checked = checked();
    let steps = async |parts: &[&str]| {
        let found: Vec<_> =
            checked.iter().filter(|query| parts.iter().all(|part| query.contains(part))).collect();
        let [query] = found[..] else { panic!("{} statements have {parts:?}", found.len()) };
        claims::steps_of(&farm, query).await
    };
    for (order, index) in [
        ("ORDER BY id DESC", "INDEX jobs_newest"),
        ("ORDER BY at_risk DESC, due_at, id", "INDEX jobs_by_risk"),
        ("ORDER BY due_at, id", "INDEX jobs_by_deadline"),
        ("ORDER BY name, id", "INDEX jobs_by_name"),
        ("ORDER BY by_cost, id", "INDEX jobs_by_cost"),
    ] {
        let steps = steps(&["SELECT id FROM jobs", "WHERE 1", order, "instr(lower(name)"]).await;
        assert!(steps[0].contains(index), "{order}: {steps:?}");
        assert!(!steps.iter().any(|step| step.contains("TEMP B-TREE")), "{order}: {steps:?}");
    }
    for sum in [
        ["FROM ledger WHERE until_at > ?1 AND from_at >= ?1", "sum("],
        ["FROM ledger WHERE until_at > ?2", "sum("],
        ["SELECT lease_id FROM ledger WHERE until_at > ?1 AND from_at < ?1", "UNION ALL"],
    ] {
        let steps = steps(&sum).await;
        let by_index = steps.iter().any(|step| step.contains("COVERING INDEX ledger_ended (until_at>?)"));
        assert!(by_index && !steps.iter().any(|step| step.starts_with("SCAN d")), "{sum:?}: {steps:?}");
    }
}
