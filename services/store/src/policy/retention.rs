//! How long things are kept: rules of projects, rules of the farm, and defaults.

use forelight_protocol::{RetentionKind, RetentionRule, Timestamp};

const DAY: i64 = 86_400_000_000;

/// How long a file is kept that nothing refers to: a day, in microseconds. A worker may be about to name it.
pub(crate) const UNUSED_KEPT: i64 = DAY;

/// The rules that people have set.
pub(crate) struct Rules(pub Vec<RetentionRule>);

impl Rules {
    /// Days that this kind of thing is kept for a project; without a project, for the farm. `None` for ever.
    fn days(&self, kind: RetentionKind, project: Option<&str>) -> Option<u32> {
        let of = |project: Option<&str>| {
            self.0.iter().find(|rule| rule.kind == kind && rule.project.as_deref() == project)
        };
        let rule = of(project).or_else(|| of(None));
        rule.map_or(Some(kind.default_days()), |rule| rule.days)
    }

    /// The instant before which things are past their time. `None` if they are kept for ever.
    pub fn cut(&self, kind: RetentionKind, project: Option<&str>, now: Timestamp) -> Option<Timestamp> {
        self.days(kind, project).map(|days| now.plus_micros(-DAY * i64::from(days)))
    }

    /// The latest of the cuts of all projects: nothing after it is past its time.
    pub fn latest_cut(&self, kind: RetentionKind, now: Timestamp) -> Option<Timestamp> {
        let projects = self.0.iter().map(|rule| rule.project.as_deref());
        projects.chain([None]).filter_map(|project| self.cut(kind, project, now)).max()
    }

    /// All rules in force: one of the farm for each kind, then those of projects.
    pub fn in_force(self) -> Vec<RetentionRule> {
        let of_farm = |kind| RetentionRule { project: None, kind, days: self.days(kind, None) };
        let mut all: Vec<RetentionRule> = RetentionKind::ALL.map(of_farm).into();
        all.extend(self.0.into_iter().filter(|rule| rule.project.is_some()));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(project: Option<&str>, kind: RetentionKind, days: Option<u32>) -> RetentionRule {
        RetentionRule { project: project.map(str::to_owned), kind, days }
    }

    #[test]
    fn a_rule_of_the_project_goes_before_that_of_the_farm_and_that_before_the_default() {
        let kind = RetentionKind::Images;
        let rules = Rules(vec![rule(None, kind, Some(10)), rule(Some("film"), kind, None)]);
        let now = Timestamp::from_micros(1000 * DAY);
        let days_ago = |cut: Option<Timestamp>| cut.map(|cut| now.micros_since(cut) / DAY);
        assert_eq!(days_ago(rules.cut(kind, Some("film"), now)), None);
        assert_eq!(days_ago(rules.cut(kind, Some("other"), now)), Some(10));
        assert_eq!(days_ago(rules.cut(RetentionKind::Profiles, Some("film"), now)), Some(7));
        assert_eq!(days_ago(rules.latest_cut(kind, now)), Some(10));
        let short = Rules(vec![rule(Some("film"), kind, Some(1))]);
        assert_eq!(days_ago(short.latest_cut(kind, now)), Some(1));
        let shown = rules.in_force();
        assert_eq!(shown.len(), RetentionKind::ALL.len() + 1);
        assert!(shown.contains(&rule(None, RetentionKind::Jobs, Some(365))));
    }
}
