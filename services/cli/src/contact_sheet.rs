//! All frames of a job in one picture. Rows of thumbnails alternate with rows of the same frames' cost maps.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use std::borrow::Cow;

/// A frame's pictures. A missing one leaves its cell dark.
#[derive(Debug, Default)]
pub struct Cell {
    pub frame: u32,
    pub image: Option<RgbImage>,
    /// In the colours of cost maps.
    pub cost_map: Option<RgbImage>,
}

/// Largest width of a thumbnail, pixels.
const THUMBNAIL_WIDTH: u32 = 240;
/// Largest number of columns.
const MOST_COLUMNS: u32 = 8;
/// Space between cells and around the sheet, pixels.
const GAP: u32 = 6;
const BACKGROUND: Rgb<u8> = Rgb([24, 24, 26]);
const EMPTY: Rgb<u8> = Rgb([40, 40, 44]);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    columns: u32,
    rows: u32,
    thumbnail: (u32, u32),
}

impl Layout {
    /// Chooses the number of columns that makes the sheet about square. Each frame has two pictures.
    fn new(cells: usize, size: (u32, u32)) -> Self {
        let width = size.0.clamp(1, THUMBNAIL_WIDTH);
        let height = (u64::from(size.1) * u64::from(width) / u64::from(size.0.max(1))).clamp(1, 4_096) as u32;
        let cells = u32::try_from(cells).unwrap_or(u32::MAX).max(1);
        let square = (f64::from(cells) * 2.0 * f64::from(height) / f64::from(width)).sqrt().ceil() as u32;
        let columns = square.clamp(1, MOST_COLUMNS).min(cells);
        Self { columns, rows: cells.div_ceil(columns), thumbnail: (width, height) }
    }

    fn size(&self) -> (u32, u32) {
        let (width, height) = self.thumbnail;
        (GAP + self.columns * (width + GAP), GAP + self.rows * (2 * height + 2 * GAP))
    }

    /// Top-left corners of a cell's image and cost map.
    fn corners(&self, cell: u32) -> [(u32, u32); 2] {
        let (width, height) = self.thumbnail;
        let x = GAP + cell % self.columns * (width + GAP);
        let y = GAP + cell / self.columns * (2 * height + 2 * GAP);
        [(x, y), (x, y + height + GAP / 2)]
    }
}

/// A picture no larger than a sheet shows it. Thousands of whole ones would not fit into memory.
pub fn thumbnail(picture: &RgbImage) -> RgbImage {
    let (width, height) = Layout::new(1, picture.dimensions()).thumbnail;
    imageops::resize(picture, width, height, FilterType::Triangle)
}

pub fn contact_sheet(cells: &[Cell]) -> RgbImage {
    let pictures = cells.iter().flat_map(|c| [&c.image, &c.cost_map]).flatten();
    let size = pictures.map(RgbImage::dimensions).next().unwrap_or((16, 9));
    let layout = Layout::new(cells.len(), size);
    let (width, height) = layout.size();
    let mut sheet = RgbImage::from_pixel(width, height, BACKGROUND);
    for (index, cell) in (0..).zip(cells) {
        let corners = layout.corners(index);
        for (picture, (x, y)) in [&cell.image, &cell.cost_map].into_iter().zip(corners) {
            let (width, height) = layout.thumbnail;
            let thumbnail = match picture {
                Some(picture) if picture.dimensions() == layout.thumbnail => Cow::Borrowed(picture),
                Some(picture) => Cow::Owned(imageops::resize(picture, width, height, FilterType::Triangle)),
                None => Cow::Owned(RgbImage::from_pixel(width, height, EMPTY)),
            };
            imageops::replace(&mut sheet, &*thumbnail, i64::from(x), i64::from(y));
        }
        let (x, y) = corners[0];
        label(&mut sheet, x + 3, y + 3, cell.frame);
    }
    sheet
}

/// Digits of 3 × 5 dots, one row per entry. The leftmost dot is bit 2.
const DIGITS: [[u8; 5]; 10] = [
    [0b111, 0b101, 0b101, 0b101, 0b111],
    [0b010, 0b110, 0b010, 0b010, 0b111],
    [0b111, 0b001, 0b111, 0b100, 0b111],
    [0b111, 0b001, 0b011, 0b001, 0b111],
    [0b101, 0b101, 0b111, 0b001, 0b001],
    [0b111, 0b100, 0b111, 0b001, 0b111],
    [0b111, 0b100, 0b111, 0b101, 0b111],
    [0b111, 0b001, 0b010, 0b010, 0b010],
    [0b111, 0b101, 0b111, 0b101, 0b111],
    [0b111, 0b101, 0b111, 0b001, 0b111],
];
const DOT: u32 = 2;

/// Writes a number in white on a dark plate. The part outside the sheet is cut off.
fn label(sheet: &mut RgbImage, x: u32, y: u32, number: u32) {
    let text = number.to_string();
    let plate = (DOT * (4 * text.len() as u32 + 1), DOT * 7);
    let mut dot = |x: u32, y: u32, color: Rgb<u8>| {
        if let Some(pixel) = sheet.get_pixel_mut_checked(x, y) {
            *pixel = color;
        }
    };
    for (dx, dy) in (0..plate.1).flat_map(|dy| (0..plate.0).map(move |dx| (dx, dy))) {
        dot(x + dx, y + dy, BACKGROUND);
    }
    for (place, digit) in (0..).zip(text.bytes()) {
        let rows = &DIGITS[usize::from(digit - b'0')];
        for (row, bits) in (0..).zip(rows) {
            for column in (0..3).filter(|column| bits & (0b100 >> column) != 0) {
                let (left, top) = (x + DOT * (1 + 4 * place + column), y + DOT * (1 + row));
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    dot(left + dx, top + dy, Rgb([255; 3]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_never_overlap_and_stay_on_the_sheet() {
        for cells in [1, 2, 5, 9, 48, 97] {
            for size in [(256, 256), (1920, 1080), (100, 4000), (1, 1)] {
                let layout = Layout::new(cells, size);
                assert!(layout.columns * layout.rows >= cells as u32);
                assert!(layout.columns * (layout.rows - 1) < cells as u32, "no empty row");
                let (width, height) = layout.size();
                let mut seen = Vec::new();
                for cell in 0..cells as u32 {
                    for (x, y) in layout.corners(cell) {
                        let (w, h) = layout.thumbnail;
                        assert!(x + w <= width && y + h <= height);
                        let apart =
                            |&(a, b): &(u32, u32)| x + w <= a || a + w <= x || y + h <= b || b + h <= y;
                        assert!(seen.iter().all(apart), "{cells} cells of {size:?}");
                        seen.push((x, y));
                    }
                }
            }
        }
    }

    #[test]
    fn each_picture_is_where_its_frame_is() {
        let plain = |color: [u8; 3]| Some(RgbImage::from_pixel(64, 64, Rgb(color)));
        let cells: Vec<Cell> = (0..6u8)
            .map(|i| Cell {
                frame: u32::from(i),
                image: plain([i * 10, 0, 200]),
                cost_map: plain([i * 10, 99, 0]),
            })
            .collect();
        let sheet = contact_sheet(&cells);
        let layout = Layout::new(6, (64, 64));
        for (i, cell) in (0..6u8).zip(0..) {
            let [(x, y), (u, v)] = layout.corners(cell);
            assert_eq!(sheet.get_pixel(x + 60, y + 60), &Rgb([i * 10, 0, 200]));
            assert_eq!(sheet.get_pixel(u + 60, v + 60), &Rgb([i * 10, 99, 0]));
        }
    }

    #[test]
    fn a_sheet_of_thumbnails_is_that_of_the_pictures() {
        let picture = RgbImage::from_fn(1920, 1080, |x, y| Rgb([x, y, x ^ y].map(|v| (v % 256) as u8)));
        let cell = |image: RgbImage| [Cell { frame: 1, image: Some(image), cost_map: None }];
        assert!(contact_sheet(&cell(thumbnail(&picture))) == contact_sheet(&cell(picture)));
    }

    #[test]
    fn a_sheet_without_pictures_is_still_a_sheet() {
        let sheet = contact_sheet(&[Cell { frame: 7, ..Cell::default() }]);
        assert!(sheet.width() > 0);
        assert!(sheet.pixels().any(|p| *p == Rgb([255; 3])), "the frame number is written");
    }
}
