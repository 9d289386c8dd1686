//! Which causes of a new plan are kept, as lines for people.

/// Most causes that are kept. One more line stands for the rest of a burst.
const MOST_CAUSES: usize = 20;

/// Adds a cause. A cause that is known already is kept once.
pub(crate) fn add_cause(causes: &mut Vec<String>, cause: &str) {
    if causes.iter().any(|known| known == cause) {
        return;
    }
    match causes.len() {
        0..MOST_CAUSES => causes.push(cause.to_owned()),
        MOST_CAUSES => causes.push("and more".to_owned()),
        _ => {}
    }
}

/// The causes that a plan has not taken into account. The plan counted `planned` happenings, the first
/// `known` causes among them; by now there were `happened`.
pub(crate) fn causes_left(causes: &[String], happened: i64, planned: i64, known: usize) -> &[String] {
    // What came in meanwhile is at the end of the list, or is a cause that was known before.
    if happened == planned { &[] } else { causes.get(known..).unwrap_or_default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_kept_as_its_first_causes_and_one_line_for_the_rest() {
        let mut causes = Vec::new();
        for node in 0..30 {
            add_cause(&mut causes, &format!("node {node} joined"));
            add_cause(&mut causes, "node 0 joined");
        }
        assert_eq!(causes.len(), MOST_CAUSES + 1);
        assert_eq!(causes.last().map(String::as_str), Some("and more"));
    }

    #[test]
    fn what_happened_while_a_plan_was_made_stays_due() {
        let causes = ["a".to_owned(), "b".to_owned()];
        assert_eq!(causes_left(&causes, 3, 2, 1), ["b"]);
        assert!(causes_left(&causes, 2, 2, 2).is_empty());
        assert!(causes_left(&causes, 3, 2, 2).is_empty(), "the same cause again");
    }
}
