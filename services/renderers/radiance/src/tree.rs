//! Counts the rays of trees that rtrace prints, by the paper's seven kinds.
//!
//! With `-o~TdnwM` rtrace prints a line for each ray: tabs for its depth, its direction, the normal where it
//! ends, its weight, and the material there. A ray's line comes after those of the rays that it causes. A
//! line `~` ends the tree. The kind of a ray is not printed. It follows from how the ray leaves the surface:
//!
//! | kind | how it is told |
//! | --- | --- |
//! | primary | it has no parent |
//! | reflected | it leaves in the mirror direction |
//! | transparent | it goes straight on |
//! | shadow | it has its parent's full weight, and another direction |
//! | refracted | it goes on below the surface, in the plane of its parent and the normal |
//! | ambient | half of its parent's weight, which Radiance gives to gathered rays; without an accuracy (`-aa 0`), one of a group of equal weights that is not around the mirror direction |
//! | specular | any other: a ray of a rough reflection or transmission |
//!
//! Shadow rays that meet nothing on the way to a light at infinity are not printed, so they are not counted.

/// Numbers of rays: primary, shadow, transparent, reflected, refracted, ambient, specular.
pub(crate) type Counts = [u64; 7];

const PRIMARY: usize = 0;
const SHADOW: usize = 1;
const TRANSPARENT: usize = 2;
const REFLECTED: usize = 3;
const REFRACTED: usize = 4;
const AMBIENT: usize = 5;
const SPECULAR: usize = 6;

/// Directions are printed with seven digits.
const SAME: f64 = 2e-5;

/// Of the weight of a gathering point, what its rays have.
const GATHERED: f64 = 0.5;

/// Cosine of the angle around the mirror direction within which rays of a rough reflection are.
const AROUND: f64 = 0.7;

/// How trees of certain settings are counted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counter {
    /// Whether gathered rays have half of the weight: with an ambient accuracy above 0.
    pub halves: bool,
    /// Most rays of a rough reflection.
    pub most_specular: usize,
}

/// A ray, as printed.
#[derive(Debug, Clone, Copy)]
struct Node {
    direction: [f64; 3],
    normal: [f64; 3],
    weight: f64,
}

/// Reads trees as they come.
pub(crate) struct Reader {
    counter: Counter,
    /// The beginning of a line that has not ended.
    line: Vec<u8>,
    /// Rays whose parent has not come, by depth.
    waiting: Vec<Vec<Node>>,
    counts: Counts,
    trees: Vec<Counts>,
    ends: usize,
}

impl Counter {
    /// A reader of trees.
    pub fn reader(self) -> Reader {
        let counts = Counts::default();
        Reader { counter: self, line: Vec::new(), waiting: Vec::new(), counts, trees: Vec::new(), ends: 0 }
    }

    /// Kinds of the rays that one ray causes.
    fn count(&self, parent: &Node, children: &[Node], counts: &mut Counts) {
        let mirror = reflected(&parent.direction, &parent.normal);
        let mut scattered: Vec<&Node> = Vec::new();
        for child in children {
            let kind = if is_same(&child.direction, &parent.direction) {
                TRANSPARENT
            } else if is_same(&child.direction, &mirror) {
                REFLECTED
            } else if child.weight >= parent.weight * (1.0 - SAME) {
                SHADOW
            } else if self.halves && (child.weight / (GATHERED * parent.weight) - 1.0).abs() < SAME {
                AMBIENT
            } else if is_refracted(parent, child) {
                REFRACTED
            } else {
                scattered.push(child);
                continue;
            };
            counts[kind] += 1;
        }
        while let Some(first) = scattered.first() {
            let weight = first.weight;
            let (group, others): (Vec<&Node>, Vec<&Node>) =
                scattered.into_iter().partition(|node| (node.weight - weight).abs() <= SAME * weight.abs());
            let around = |node: &&Node| {
                dot(&node.direction, &mirror) > AROUND || dot(&node.direction, &parent.direction) > AROUND
            };
            let is_specular = self.halves || (group.len() <= self.most_specular && group.iter().all(around));
            counts[if is_specular { SPECULAR } else { AMBIENT }] += group.len() as u64;
            scattered = others;
        }
    }
}

impl Reader {
    /// Reads more of what rtrace printed.
    ///
    /// # Errors
    /// The line that is not understood.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(), String> {
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|&byte| byte == b'\n') {
            let mut line = std::mem::take(&mut self.line);
            line.extend_from_slice(&rest[..end]);
            rest = &rest[end + 1..];
            self.take(&line).ok_or_else(|| {
                let line = String::from_utf8_lossy(&line);
                format!("rtrace printed `{}` where a ray was expected", line.escape_debug())
            })?;
            line.clear();
            self.line = line;
        }
        self.line.extend_from_slice(rest);
        Ok(())
    }

    /// Counts of the trees that have ended.
    pub fn trees(&self) -> &[Counts] {
        &self.trees
    }

    /// Ends of trees that were read, with those of rays without a tree.
    pub fn ends(&self) -> usize {
        self.ends
    }

    fn take(&mut self, line: &[u8]) -> Option<()> {
        if line.starts_with(b"~") {
            self.ends += 1;
            if self.counts != Counts::default() {
                self.trees.push(std::mem::take(&mut self.counts));
            }
            return Some(());
        }
        let depth = line.iter().take_while(|&&byte| byte == b'\t').count();
        // Names may be in any encoding.
        let text = String::from_utf8_lossy(&line[depth..]);
        let mut words = text.split('\t');
        let mut number = || words.next()?.parse::<f64>().ok();
        let mut triple = || Some([number()?, number()?, number()?]);
        let (direction, normal) = (triple()?, triple()?);
        let weight = number()?;
        if !direction.iter().chain([&weight]).all(|number| number.is_finite()) {
            return None;
        }
        // A ray that ends at a light at infinity has no normal: rtrace prints what its memory holds.
        let normal = normal.map(|number| if number.is_finite() { number } else { 0.0 });
        let node = Node { direction, normal, weight };
        if self.waiting.len() < depth + 2 {
            self.waiting.resize_with(depth + 2, Vec::new);
        }
        let children = std::mem::take(&mut self.waiting[depth + 1]);
        self.counter.count(&node, &children, &mut self.counts);
        self.waiting[depth + 1] = children;
        self.waiting[depth + 1].clear();
        if depth == 0 {
            self.counts[PRIMARY] += 1;
        } else {
            self.waiting[depth].push(node);
        }
        Some(())
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn is_same(a: &[f64; 3], b: &[f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME)
}

fn reflected(direction: &[f64; 3], normal: &[f64; 3]) -> [f64; 3] {
    let twice = 2.0 * dot(direction, normal);
    [0, 1, 2].map(|axis| direction[axis] - twice * normal[axis])
}

/// Whether the child goes on below the surface, in the plane of its parent and the normal.
fn is_refracted(parent: &Node, child: &Node) -> bool {
    let (d, n) = (&parent.direction, &parent.normal);
    let across = [d[1] * n[2] - d[2] * n[1], d[2] * n[0] - d[0] * n[2], d[0] * n[1] - d[1] * n[0]];
    dot(d, n) * dot(&child.direction, n) > 0.0 && dot(&across, &child.direction).abs() < SAME
}

#[cfg(test)]
mod tests {
    use super::*;

    const CACHED: Counter = Counter { halves: true, most_specular: 1 };
    const UNCACHED: Counter = Counter { halves: false, most_specular: 1 };

    fn line(depth: usize, direction: [f64; 3], weight: f64) -> String {
        let [x, y, z] = direction;
        format!("{}{x:e}\t{y:e}\t{z:e}\t0\t0\t1e0\t{weight:e}\tfloor\t\n", "\t".repeat(depth))
    }

    fn count(counter: Counter, lines: &[String]) -> Vec<Counts> {
        let mut reader = counter.reader();
        // In pieces that end anywhere.
        for piece in lines.concat().as_bytes().chunks(7) {
            reader.read(piece).unwrap();
        }
        reader.trees().to_vec()
    }

    /// A ray that comes down on a floor at 45°.
    const DOWN: [f64; 3] = [0.6, 0.0, -0.8];

    #[test]
    fn a_ray_is_told_by_its_direction_and_weight() {
        let end = "~\t\n".to_owned();
        for (child, weight, kind) in [
            ([0.6, 0.0, 0.8], 0.05, REFLECTED),
            ([0.6, 0.0, 0.8], 1.0, REFLECTED),
            (DOWN, 1.0, TRANSPARENT),
            (DOWN, 0.8, TRANSPARENT),
            ([0.0, 0.6, 0.8], 1.0, SHADOW),
            ([0.28, 0.0, -0.96], 0.9, REFRACTED),
            ([0.0, 0.6, 0.8], 0.5, AMBIENT),
            ([0.6, 0.1, 0.79], 0.05, SPECULAR),
        ] {
            let found = count(CACHED, &[line(1, child, weight), line(0, DOWN, 1.0), end.clone()]);
            let mut expected = Counts::default();
            expected[PRIMARY] = 1;
            expected[kind] = 1;
            assert_eq!(found, [expected], "{child:?} {weight}");
        }
    }

    #[test]
    fn without_an_accuracy_groups_away_from_the_mirror_are_gathered() {
        let gathered = (0..9).map(|i| line(1, [0.1 * f64::from(i) - 0.4, 0.3, 0.9], 0.07));
        let rough = line(1, [0.62, 0.02, 0.78], 0.04);
        let lines: Vec<String> = gathered.chain([rough, line(0, DOWN, 1.0), "~\t\n".to_owned()]).collect();
        let mut expected = Counts::default();
        (expected[PRIMARY], expected[AMBIENT], expected[SPECULAR]) = (1, 9, 1);
        assert_eq!(count(UNCACHED, &lines), [expected]);
    }

    #[test]
    fn descendants_belong_to_the_next_ray_of_the_depth_above() {
        let shadow = |depth| line(depth, [0.0, 0.6, 0.8], 0.5);
        let lines = [
            shadow(2),
            line(1, [0.6, 0.0, 0.8], 0.5),
            line(1, DOWN, 0.9),
            line(0, DOWN, 1.0),
            "~\t\n".to_owned(),
            line(0, DOWN, 1.0),
            "~\t\n".to_owned(),
            "~\t\n".to_owned(),
        ];
        assert_eq!(count(CACHED, &lines), [[1, 1, 1, 1, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0]]);
    }

    #[test]
    fn rays_without_weight_are_counted() {
        let rough = || line(1, [0.6, 0.1, 0.79], 0.0);
        let lines = [rough(), rough(), line(0, DOWN, 1.0), "~\t\n".to_owned()];
        assert_eq!(count(CACHED, &lines), [[1, 0, 0, 0, 0, 0, 2]]);
    }

    #[test]
    fn a_ray_that_ends_at_a_light_at_infinity_has_no_normal() {
        let sky = "\t0\t6e-1\t8e-1\t-6.9e-310\tnan\tinf\t5e-1\tsky\t\n".to_owned();
        let lines = [sky, line(0, DOWN, 1.0), "~\t\n".to_owned()];
        assert_eq!(count(CACHED, &lines), [[1, 0, 0, 0, 0, 1, 0]]);
    }

    #[test]
    fn a_line_that_is_no_ray_is_named() {
        for text in ["rtrace: help", "12\r", "0\t0\t-1\t0\t0\t1\tnan\tfloor\t"] {
            let error = CACHED.reader().read(format!("{text}\n").as_bytes()).unwrap_err();
            assert!(error.contains(&format!("`{}`", text.escape_debug())), "{error}");
        }
    }
}
