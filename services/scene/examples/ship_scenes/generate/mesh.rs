//! Triangle meshes: vertices with attributes, and operations that place and join meshes.

use glam::{DMat3, DVec2, DVec3, dvec2};

/// A corner of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Position, in metres.
    pub position: DVec3,
    /// Unit shading normal, on the side from which the triangle looks counter-clockwise.
    pub normal: DVec3,
    /// Texture coordinates; v points up.
    pub uv: DVec2,
}

/// A triangle mesh. Triangles are counter-clockwise seen from the front.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertices. Equal ones are merged when the mesh is written.
    pub vertices: Vec<Vertex>,
    /// Three vertex indices per triangle.
    pub triangles: Vec<[usize; 3]>,
}

/// A coordinate axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Right.
    X,
    /// Up.
    Y,
    /// Towards the viewer.
    Z,
}

impl Mesh {
    /// Adds a vertex and returns its index.
    pub fn vertex(&mut self, position: DVec3, normal: DVec3, uv: DVec2) -> usize {
        self.vertices.push(Vertex { position, normal, uv });
        self.vertices.len() - 1
    }

    /// Adds a quadrilateral as two triangles. Its corners run counter-clockwise seen from the front.
    pub fn patch(&mut self, [a, b, c, d]: [usize; 4]) {
        self.triangles.push([a, b, c]);
        self.triangles.push([a, c, d]);
    }

    /// Adds a flat quadrilateral, corners counter-clockwise, texture coordinates from (0, 0) to (1, 1).
    pub fn flat_patch(&mut self, corners: [DVec3; 4]) {
        let normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]).normalize();
        let uvs = [dvec2(0.0, 0.0), dvec2(1.0, 0.0), dvec2(1.0, 1.0), dvec2(0.0, 1.0)];
        let indices = [0, 1, 2, 3].map(|i| self.vertex(corners[i], normal, uvs[i]));
        self.patch(indices);
    }

    /// Appends another mesh.
    pub fn with(mut self, other: Mesh) -> Mesh {
        let first = self.vertices.len();
        self.vertices.extend(other.vertices);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
        self
    }

    /// Joins several meshes into one.
    pub fn join(meshes: impl IntoIterator<Item = Mesh>) -> Mesh {
        meshes.into_iter().fold(Mesh::default(), Mesh::with)
    }

    /// Translates the mesh, in metres.
    pub fn at(mut self, x: f64, y: f64, z: f64) -> Mesh {
        for vertex in &mut self.vertices {
            vertex.position += DVec3::new(x, y, z);
        }
        self
    }

    /// Rotates the mesh about an axis through the origin, counter-clockwise seen against the axis.
    pub fn turned(mut self, axis: Axis, degrees: f64) -> Mesh {
        let (sin, cos) = sine_cosine(degrees);
        let turn = match axis {
            Axis::X => DMat3::from_cols_array(&[1.0, 0.0, 0.0, 0.0, cos, sin, 0.0, -sin, cos]),
            Axis::Y => DMat3::from_cols_array(&[cos, 0.0, -sin, 0.0, 1.0, 0.0, sin, 0.0, cos]),
            Axis::Z => DMat3::from_cols_array(&[cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0]),
        };
        for vertex in &mut self.vertices {
            vertex.position = turn * vertex.position;
            vertex.normal = turn * vertex.normal;
        }
        self
    }

    /// Reverses winding and normals, so that the mesh is visible from inside.
    pub fn inside_out(mut self) -> Mesh {
        for vertex in &mut self.vertices {
            vertex.normal = -vertex.normal;
        }
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
        self
    }

    /// Removes the triangles whose centroid is above a height.
    pub fn cut_above(mut self, height: f64) -> Mesh {
        let Mesh { vertices, triangles } = &mut self;
        triangles.retain(|t| t.iter().map(|&i| vertices[i].position.y).sum::<f64>() / 3.0 <= height);
        let mut used = vec![false; vertices.len()];
        triangles.iter().flatten().for_each(|&i| used[i] = true);
        let mut places = Vec::with_capacity(used.len());
        let mut count = 0;
        for &keep in &used {
            places.push(count);
            count += usize::from(keep);
        }
        let mut kept = used.iter();
        vertices.retain(|_| kept.next().copied().unwrap_or(false));
        for triangle in triangles {
            *triangle = triangle.map(|i| places[i]);
        }
        self
    }

    /// Scales the mesh about the origin by positive factors.
    pub fn stretched(mut self, x: f64, y: f64, z: f64) -> Mesh {
        let factors = DVec3::new(x, y, z);
        for vertex in &mut self.vertices {
            vertex.position *= factors;
            vertex.normal = (vertex.normal / factors).normalize();
        }
        self
    }

    /// Sets texture coordinates by projection along the axis nearest to each vertex normal. One repeat covers
    /// `repeat` metres; u runs along `grain` where visible.
    pub fn textured(mut self, repeat: f64, grain: Axis) -> Mesh {
        for vertex in &mut self.vertices {
            let (p, n) = (vertex.position / repeat, vertex.normal.abs());
            let (first, second, across) = if n.y >= n.x && n.y >= n.z {
                (p.x, -p.z, grain == Axis::Z)
            } else if n.x >= n.z {
                (p.z, p.y, grain == Axis::Y)
            } else {
                (p.x, p.y, grain == Axis::Y)
            };
            vertex.uv = if across { dvec2(second, first) } else { dvec2(first, second) };
        }
        self
    }
}

/// Sine and cosine of an angle in degrees. The result is the same on every machine.
pub fn sine_cosine(degrees: f64) -> (f64, f64) {
    libm::sincos(degrees.to_radians())
}
