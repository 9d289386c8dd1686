//! What the paper's tables print: errors in percent, of rays and of cost.

use super::level::Level;
use forelight_forecast::Strategy;

/// A printed row: percent of rays and of cost. `None`: the row is lost in our copy of the paper.
type Row = Option<(u32, u32)>;

/// Rows of a table: grid, jittered, Halton, Hammersley, random average, random area weighted, Snapshot.
type Rows = [Row; 7];

const STRATEGIES: [Strategy; 7] = [
    Strategy::RegularGrid,
    Strategy::Jittered,
    Strategy::Halton,
    Strategy::Hammersley,
    Strategy::Random,
    Strategy::RandomArea,
    Strategy::PaperSnapshot,
];

/// Tables 1 to 5.
const TABLES: [(&str, Level, Rows); 5] = [
    (
        "kitchen",
        Level::NoAmbient,
        [
            Some((1, 10)),
            Some((3, 9)),
            Some((4, 9)),
            Some((1, 11)),
            Some((3, 17)),
            Some((5, 19)),
            Some((2, 2)),
        ],
    ),
    (
        "kitchen",
        Level::OneBounce,
        [
            Some((1, 15)),
            Some((3, 13)),
            Some((2, 14)),
            Some((0, 16)),
            Some((0, 16)),
            Some((1, 8)),
            Some((1, 4)),
        ],
    ),
    (
        "kitchen",
        Level::OneBounceCached,
        [
            None,
            Some((727, 888)),
            Some((783, 946)),
            Some((805, 963)),
            Some((739, 889)),
            Some((791, 863)),
            Some((918, 918)),
        ],
    ),
    (
        "corridor",
        Level::NoAmbient,
        [Some((7, 4)), Some((1, 1)), Some((2, 3)), Some((5, 3)), Some((2, 3)), Some((5, 0)), Some((3, 2))],
    ),
    (
        "corridor",
        Level::OneBounce,
        [None, Some((3, 6)), Some((0, 4)), Some((1, 4)), Some((1, 3)), Some((2, 0)), Some((0, 4))],
    ),
];

/// Number of the paper's table of a scene at a level. `None` if it has none.
pub fn table(scene: &str, level: Level) -> Option<usize> {
    let is_it = |(name, of, _): &(&str, Level, Rows)| scene.to_lowercase().contains(name) && *of == level;
    Some(TABLES.iter().position(is_it)? + 1)
}

/// Percent of rays and of cost that this table prints for a strategy.
pub fn row(table: usize, strategy: Strategy) -> Row {
    let (.., rows) = TABLES.get(table.checked_sub(1)?)?;
    rows[STRATEGIES.iter().position(|&one| one == strategy)?]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_found_by_scene_and_level() {
        assert_eq!(table("Our kitchen", Level::OneBounceCached), Some(3));
        assert_eq!(table("corridor", Level::OneBounce), Some(5));
        assert_eq!(table("corridor", Level::TwoBouncesCached), None);
        assert_eq!(row(1, Strategy::PaperSnapshot), Some((2, 2)));
        assert_eq!(row(3, Strategy::RegularGrid), None);
        assert_eq!(row(2, Strategy::Snapshot), None);
    }
}
