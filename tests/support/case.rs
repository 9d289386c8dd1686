//! One line for every hard case: what must hold, the worst that was seen, and the limit.

/// A case of the table of hard cases, and what it says.
pub struct Case {
    number: u32,
    sentence: String,
}

/// Case `number` of the table; `sentence` says what must hold.
pub fn case(number: u32, sentence: impl Into<String>) -> Case {
    Case { number, sentence: sentence.into() }
}

impl Case {
    /// Prints the worst value beside its limit, and panics unless it is at most the limit. NaN is beyond
    /// every limit.
    #[track_caller]
    pub fn worst(self, value: f64, limit: f64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  worst {value:<9.3e}  limit {limit:.3e}");
        assert!(value <= limit, "case {number}: {sentence}: {value} is more than {limit}");
    }

    /// Prints the least value beside its limit, and panics unless it is at least the limit.
    #[track_caller]
    pub fn least(self, value: f64, limit: f64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  least {value:<9.3e}  limit {limit:.3e}");
        assert!(value >= limit, "case {number}: {sentence}: {value} is less than {limit}");
    }

    /// For what must never happen: prints how often it did, of how many.
    #[track_caller]
    pub fn never(self, count: u64, of: u64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  {count} of {of}");
        assert!(of > 0, "case {number}: {sentence}: nothing was tried");
        assert_eq!(count, 0, "case {number}: {sentence}: {count} of {of}");
    }
}
