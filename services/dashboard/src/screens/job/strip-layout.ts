// Where the cells of a frame strip lie: one row if they fit, else rows like lines of a text.

export interface StripLayout {
  count: number;
  perRow: number;
  rows: number;
  /** Width and height of a cell with its gap, CSS pixels. */
  cell: [width: number, height: number];
  /** Where the first cell begins. One row stands exactly above the plot of the same frames. */
  left: number;
}

/** Room beside the row of cells that the plot needs for its axis and its edge. */
export const MARGINS = { left: 72, right: 12 };

const SIZES: [number, number][] = [
  [22, 26],
  [16, 24],
  [12, 22],
  [10, 20],
  [8, 18],
  [6, 15],
  [5, 13],
  [4, 11],
  [3, 9],
];
const HIGHEST = 260;

/** The largest cells with which so many frames fit into a strip of this width. */
export function layOut(count: number, width: number): StripLayout {
  const usable = Math.max(width, 60);
  const above = (usable - MARGINS.left - MARGINS.right) / count;
  if (above >= 4)
    return { count, perRow: count, rows: 1, cell: [above, above < 10 ? 20 : 26], left: MARGINS.left };
  for (const [w, h] of SIZES) {
    const fits = Math.floor(usable / w);
    // Rows of a round number of frames are easier to read.
    const perRow = fits >= count ? count : fits >= 20 ? fits - (fits % 10) : fits;
    const rows = Math.ceil(count / perRow);
    const last = w === SIZES[SIZES.length - 1]![0];
    if (rows === 1 || rows * h <= HIGHEST || last)
      return { count, perRow: Math.max(1, perRow), rows, cell: [w, h], left: 0 };
  }
  throw new Error("the smallest size always fits");
}

/** The cell at a point, or the nearest one. */
export function cellAt(layout: StripLayout, x: number, y: number): number {
  const row = Math.min(layout.rows - 1, Math.max(0, Math.floor(y / layout.cell[1])));
  const column = Math.min(layout.perRow - 1, Math.max(0, Math.floor((x - layout.left) / layout.cell[0])));
  return Math.min(layout.count - 1, row * layout.perRow + column);
}
