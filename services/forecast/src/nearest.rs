//! Finds the nearest marked pixel to each pixel of an image, by an exact distance transform.

/// For each pixel in row order, the index into `marked` of a nearest marked pixel. The image has `pixels`
/// pixels in rows of `width`. At least one pixel must be marked, and all marks must lie inside; otherwise the
/// result is empty.
///
/// Exact and in linear time: one pass along columns, one along rows, on the lower envelope of parabolas
/// (Meijster, Roerdink, Hesselink 2000, "A general algorithm for computing distance transforms in linear
/// time").
pub fn nearest(width: u32, pixels: usize, marked: &[u32]) -> Vec<u32> {
    let row = width as usize;
    if row == 0 || !pixels.is_multiple_of(row) || marked.is_empty() {
        return Vec::new();
    }
    let mut in_column: Vec<Option<u32>> = vec![None; pixels];
    for (index, &pixel) in (0u32..).zip(marked) {
        let Some(place) = in_column.get_mut(pixel as usize) else { return Vec::new() };
        place.get_or_insert(index);
    }
    let row_of = |index: u32| (marked[index as usize] / width) as usize;
    let nearer = |here: usize, one: Option<u32>, other: Option<u32>| match (one, other) {
        (Some(a), Some(b)) if row_of(b).abs_diff(here) < row_of(a).abs_diff(here) => Some(b),
        (Some(a), _) => Some(a),
        (None, b) => b,
    };
    // Each pixel takes over its neighbour's nearest mark in the column: downwards, then upwards.
    for pixel in row..pixels {
        in_column[pixel] = nearer(pixel / row, in_column[pixel], in_column[pixel - row]);
    }
    for pixel in (0..pixels - row).rev() {
        in_column[pixel] = nearer(pixel / row, in_column[pixel], in_column[pixel + row]);
    }
    let mut found = Vec::with_capacity(pixels);
    let mut envelope = Vec::new();
    for (y, columns) in in_column.chunks(row).enumerate() {
        let parabolas = columns.iter().enumerate().filter_map(|(x, &index)| {
            let height = row_of(index?).abs_diff(y) as i64;
            Some(Parabola { x: x as i64, height: height * height, index: index?, from: 0 })
        });
        lower_envelope(parabolas, row as i64, &mut envelope);
        let mut current = 0;
        for x in 0..row as i64 {
            while envelope.get(current + 1).is_some_and(|next: &Parabola| next.from <= x) {
                current += 1;
            }
            found.push(envelope[current].index);
        }
    }
    found
}

/// Squared distance to the marked pixel of one column, along a row: (x − column)² + height.
#[derive(Clone, Copy)]
struct Parabola {
    x: i64,
    height: i64,
    index: u32,
    /// First place where it is the lowest.
    from: i64,
}

/// Lower envelope within the row: which parabola is lowest from where. They must be in column order.
fn lower_envelope(parabolas: impl Iterator<Item = Parabola>, width: i64, envelope: &mut Vec<Parabola>) {
    envelope.clear();
    for mut next in parabolas {
        let at = |p: &Parabola, x: i64| (x - p.x) * (x - p.x) + p.height;
        while envelope.last().is_some_and(|last| at(last, last.from) > at(&next, last.from)) {
            envelope.pop();
        }
        next.from = match envelope.last() {
            None => 0,
            Some(last) => {
                let squares = next.x * next.x - last.x * last.x + next.height - last.height;
                1 + squares.div_euclid(2 * (next.x - last.x))
            }
        };
        if next.from < width {
            envelope.push(next);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::nearest;
    use crate::random::hash;

    #[test]
    fn the_nearest_marked_pixel_is_that_of_looking_at_all() {
        for (case, (width, height)) in [(1, 1), (7, 1), (1, 9), (16, 16), (33, 21)].into_iter().enumerate() {
            for count in [1, 2, 3, 10, 100] {
                let pixels = width * height;
                let marked: Vec<u32> =
                    (0..count).map(|i| (hash(&[case as u64, count, i]) % u64::from(pixels)) as u32).collect();
                let apart = |a: u32, b: u32| {
                    let dx = i64::from(a % width) - i64::from(b % width);
                    let dy = i64::from(a / width) - i64::from(b / width);
                    dx * dx + dy * dy
                };
                let found = nearest(width, pixels as usize, &marked);
                assert_eq!(found.len(), pixels as usize);
                for (pixel, index) in (0..pixels).zip(found) {
                    let least = marked.iter().map(|&m| apart(m, pixel)).min();
                    assert_eq!(
                        Some(apart(marked[index as usize], pixel)),
                        least,
                        "{width} x {height}, {pixel}"
                    );
                }
            }
        }
    }

    #[test]
    fn nothing_marked_or_marks_outside_the_image_have_no_nearest() {
        assert!(nearest(4, 16, &[]).is_empty());
        assert!(nearest(4, 16, &[16]).is_empty());
        assert!(nearest(0, 0, &[0]).is_empty());
    }
}
