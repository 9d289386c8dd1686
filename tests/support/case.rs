//! Prints one line for every hard case: the invariant, the worst value and the limit.

/// A case of the table of hard cases, with its invariant.
pub struct Case {
    number: u32,
    sentence: String,
}

/// Case `number` of the table. `sentence` states the invariant.
pub fn case(number: u32, sentence: impl Into<String>) -> Case {
    Case { number, sentence: sentence.into() }
}

impl Case {
    /// Prints the worst value and its limit. Panics if the value is above the limit or NaN.
    #[track_caller]
    pub fn worst(self, value: f64, limit: f64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  worst {value:<9.3e}  limit {limit:.3e}");
        assert!(value <= limit, "case {number}: {sentence}: {value} is more than {limit}");
    }

    /// Prints the least value and its limit. Panics if the value is below the limit or NaN.
    #[track_caller]
    pub fn least(self, value: f64, limit: f64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  least {value:<9.3e}  limit {limit:.3e}");
        assert!(value >= limit, "case {number}: {sentence}: {value} is less than {limit}");
    }

    /// Prints how often something forbidden happened, and panics if it did.
    #[track_caller]
    pub fn never(self, count: u64, of: u64) {
        let Self { number, sentence } = self;
        println!("case {number:>2}  {sentence:<96}  {count} of {of}");
        assert!(of > 0, "case {number}: {sentence}: nothing was tried");
        assert_eq!(count, 0, "case {number}: {sentence}: {count} of {of}");
    }
}
