//! Fills a database by SQL, with copies of real rows.

use rusqlite::Connection;

/// Runs statements.
pub fn run(database: &Connection, statements: &str) {
    database.execute_batch(statements).unwrap_or_else(|error| panic!("{statements}: {error}"));
}

/// Copies rows of a table once for each row of `each`, with other values in some columns.
pub fn copy(database: &Connection, table: &str, which: &str, each: &str, other: &[(&str, &str)]) {
    let mut columns = database
        .prepare(&format!("SELECT name FROM pragma_table_xinfo('{table}') WHERE hidden = 0"))
        .unwrap();
    let columns: Vec<String> = columns.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
    let value = |name: &String| {
        let changed = other.iter().find(|(other, _)| other == name);
        changed.map_or(format!("t.{name}"), |(_, value)| (*value).to_owned())
    };
    let values: Vec<String> = columns.iter().map(value).collect();
    let (columns, values) = (columns.join(", "), values.join(", "));
    let statement =
        format!("INSERT INTO {table} ({columns}) SELECT {values} FROM {table} t, {each} WHERE {which}");
    database.execute(&statement, []).unwrap_or_else(|error| panic!("{statement}: {error}"));
}
