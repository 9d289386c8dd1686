//! Tables, and text between them.

use anyhow::Result;
use forelight_terminal::json_file;
use forelight_terminal::output;
use forelight_terminal::table::Table;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `1.23 %`
pub fn share(fraction: f64) -> String {
    format!("{:.2} %", fraction * 100.0)
}

#[derive(Debug, Default)]
pub struct Report(Vec<Block>);

#[derive(Debug)]
enum Block {
    /// As a terminal shows it. Every line ends with a newline.
    Text(String),
    Table(Table),
}

impl Report {
    #[must_use]
    pub fn table(mut self, table: Table) -> Self {
        self.0.push(Block::Table(table));
        self
    }

    /// Adds text as a terminal shows it. Every line must end with a newline.
    #[must_use]
    pub fn text(mut self, text: impl Into<String>) -> Self {
        self.0.push(Block::Text(text.into()));
        self
    }

    #[must_use]
    pub fn then(mut self, other: Report) -> Self {
        self.0.extend(other.0);
        self
    }

    /// Prints the document as JSON if `json` is set, and otherwise the report. Returns the report.
    pub fn printed(self, json: bool, document: &impl Serialize) -> Result<Self> {
        if json {
            output::json(document)?
        } else {
            output::print(&self.for_terminal())?
        }
        Ok(self)
    }

    /// Measures bundles one after the other. Prints the report of each at once, since the next may take hours, or
    /// all measurements as JSON at the end; also writes these to the file `out`. Returns the whole report.
    pub fn of_each<T: Serialize>(
        bundles: &[PathBuf],
        (json, out): (bool, Option<&Path>),
        mut measured: impl FnMut(&Path) -> Result<T>,
        report: impl Fn(&T) -> Self,
    ) -> Result<Self> {
        let mut whole = Self::default();
        let mut all = Vec::with_capacity(bundles.len());
        for bundle in bundles {
            let one = measured(bundle)?;
            let own = report(&one);
            if !json {
                output::print(&own.for_terminal())?;
            }
            whole = whole.then(own);
            all.push(one);
        }
        json_file::write(out, &all)?;
        if json {
            output::json(&all)?;
        }
        Ok(whole)
    }

    pub fn for_terminal(&self) -> String {
        let block = |block: &Block| match block {
            Block::Text(text) => text.clone(),
            Block::Table(table) => table.render(),
        };
        self.0.iter().map(block).collect()
    }

    /// The report in Markdown. Every line of text becomes a paragraph.
    pub fn markdown(&self) -> String {
        let mut parts = Vec::new();
        for block in &self.0 {
            match block {
                Block::Text(text) => {
                    let paragraphs = text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
                    let paragraphs = paragraphs.filter(|words| !words.is_empty());
                    parts.extend(paragraphs.map(|words| words.join(" ") + "\n"));
                }
                Block::Table(table) => parts.push(table.markdown()),
            }
        }
        parts.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::Report;
    use forelight_terminal::table::{Align, Table};

    #[test]
    fn a_terminal_shows_blocks_as_they_are_and_markdown_makes_paragraphs_of_lines() {
        let mut table = Table::new(&[("bundle", Align::Left)]);
        table.row(["kitchen".into()]);
        let report = Report::default().text("calls for  sun\nleft out   sky\n").table(table).text("\n");
        assert_eq!(report.for_terminal(), "calls for  sun\nleft out   sky\nbundle\n-------\nkitchen\n\n");
        assert_eq!(report.markdown(), "calls for sun\n\nleft out sky\n\n| bundle |\n| --- |\n| kitchen |\n");
    }
}
