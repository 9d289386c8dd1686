//! A scene for a whole shot, and its frames. [`Scene::frame`] evaluates nodes and curves at one time and
//! transforms meshes to world space. Geometry that does not move is shared between frames.

mod loading;

use crate::animation::Animated;
use crate::assembly::{NodeLight, NodeLightKind};
use crate::camera_source::CameraSource;
use crate::error::SceneError;
use crate::light_source::LightSource;
use crate::limits::LARGEST_COORDINATE;
use crate::shot::{Baked, Shot};
use crate::{Camera, Environment, Frame, Geometry, Material, PointLight, Strata, Sun, Texture};
use glam::{DMat4, DVec3, Vec3};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

pub(crate) use loading::Entry;

/// The content of a bundle, from which several threads can make frames. As long as nothing moves, all share
/// the same [`Geometry`].
#[derive(Debug, Serialize, Deserialize)]
pub struct Scene {
    name: String,
    /// The file that errors of single frames name.
    file: String,
    fps: f64,
    frames: u32,
    /// Time of frame 0 on the curves, in frames.
    start: f64,
    warnings: Vec<String>,
    digest: [u8; 32],
    camera: CameraSource,
    shot: Shot,
    /// For each node, whether it moves.
    moving: Vec<bool>,
    /// The moving nodes that carry geometry. Only their positions can make the geometry of two frames differ.
    movers: Vec<usize>,
    /// World matrices and geometry of frame 0.
    still_world: Vec<DMat4>,
    still: Baked,
    /// World matrices and geometry of the most recently made frame whose geometry differs from frame 0.
    #[serde(skip)]
    recent: Mutex<Option<(Vec<DMat4>, Arc<Geometry>)>>,
    materials: Arc<[Material]>,
    /// Emission over time, with the index of its material.
    emission: Vec<(usize, Animated<DVec3>)>,
    textures: Arc<[Texture]>,
    /// Lights from `scene.json`.
    lights: Vec<LightSource>,
    node_lights: Vec<NodeLight>,
    environment: Environment,
}

impl Scene {
    /// Number of frames. Frames are numbered from 0.
    pub fn frame_count(&self) -> u32 {
        self.frames
    }

    /// Frames per second.
    pub fn fps(&self) -> f64 {
        self.fps
    }

    /// Short name of the scene.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Problems that did not prevent the scene from loading, one line each.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// BLAKE3 hash of the paths and contents of all files that the scene was loaded from.
    pub fn digest(&self) -> [u8; 32] {
        self.digest
    }

    /// Whether any geometry moves during the shot; cameras and lights do not count. Compares the positions of
    /// nodes frame by frame.
    pub fn geometry_moves(&self) -> bool {
        let moved = |frame| !self.same_places(&self.shot.world(self.time(frame)), &self.still_world);
        !self.movers.is_empty() && (1..self.frames).any(moved)
    }

    /// The (object, material) pairs. They are the same for every frame.
    pub fn strata(&self) -> &Strata {
        &self.shot.strata
    }

    /// The camera at a frame. Fails if the frame is outside the shot, or the camera is not valid there.
    pub fn camera(&self, frame: u32) -> Result<Camera, SceneError> {
        self.check_number(frame)?;
        match &self.camera {
            CameraSource::LookAt(_) => self.camera_at(frame, &[]),
            CameraSource::Node(_) => self.camera_at(frame, &self.shot.world(self.time(frame))),
        }
    }

    /// The camera at a frame, with another image size (width, height), at least (1, 1). It keeps the horizontal
    /// field of view, or the vertical one of a camera that was described by that alone. Errors as for
    /// [`Scene::camera`].
    pub fn camera_with(&self, frame: u32, (width, height): (u32, u32)) -> Result<Camera, SceneError> {
        Ok(self.camera.resized(self.camera(frame)?, width, height))
    }

    /// The world at a frame. Fails if the frame is outside the shot, the camera is not valid there, or
    /// something is too far from the origin.
    pub fn frame(&self, number: u32) -> Result<Frame, SceneError> {
        self.frame_with(number, None)
    }

    /// The world at a frame, with another image size (width, height); see [`Scene::camera_with`]. Errors as
    /// for [`Scene::frame`], and if the size is zero.
    pub fn frame_with(&self, number: u32, size: Option<(u32, u32)>) -> Result<Frame, SceneError> {
        self.check_number(number)?;
        let time = self.time(number);
        let world = self.shot.world(time);
        let mut camera = self.camera_at(number, &world)?;
        if let Some((width, height)) = size {
            if width == 0 || height == 0 {
                return Err(SceneError::file(&self.file, "an image must have at least one pixel"));
            }
            camera = self.camera.resized(camera, width, height);
        }
        let (points, suns) = self.lights_at(time, &world)?;
        Ok(Frame {
            number,
            camera,
            geometry: self.geometry_at(world)?,
            materials: self.materials_at(time),
            textures: self.textures.clone(),
            points,
            suns,
            environment: self.environment.clone(),
        })
    }

    fn time(&self, frame: u32) -> f64 {
        self.start + f64::from(frame)
    }

    fn check_number(&self, frame: u32) -> Result<(), SceneError> {
        if frame >= self.frames {
            return Err(SceneError::FrameOutside { frame, last: self.frames - 1 });
        }
        Ok(())
    }

    fn camera_at(&self, frame: u32, world: &[DMat4]) -> Result<Camera, SceneError> {
        match &self.camera {
            CameraSource::LookAt(look_at) => look_at
                .at(self.time(frame), self.shot.origin)
                .map_err(|reason| SceneError::pointer(&self.file, "/camera", reason)),
            CameraSource::Node(camera) => Some(&world[camera.node])
                .filter(|world| is_near(world))
                .ok_or_else(|| "the camera's node is too far from the origin".to_owned())
                .and_then(|world| camera.at(world))
                .map_err(|reason| SceneError::file(&self.file, format!("{reason} at frame {frame}"))),
        }
    }

    fn geometry_at(&self, world: Vec<DMat4>) -> Result<Arc<Geometry>, SceneError> {
        if self.same_places(&world, &self.still_world) {
            return Ok(self.still.geometry.clone());
        }
        // The lock is not held while vertices are computed, so threads do not wait for each other.
        let recent = || self.recent.lock();
        if let Some((_, geometry)) = recent().as_ref().filter(|(known, _)| self.same_places(known, &world)) {
            return Ok(geometry.clone());
        }
        let geometry = Arc::new(self.shot.bake_moving(&world, &self.moving, &self.still)?);
        *recent() = Some((world, geometry.clone()));
        Ok(geometry)
    }

    /// Returns `true` if all geometry has the same positions in two worlds.
    fn same_places(&self, a: &[DMat4], b: &[DMat4]) -> bool {
        self.movers.iter().all(|&node| a[node] == b[node])
    }

    fn materials_at(&self, time: f64) -> Arc<[Material]> {
        if self.emission.iter().all(|(_, radiance)| radiance.is_constant()) {
            return self.materials.clone();
        }
        let mut materials = self.materials.to_vec();
        for (material, radiance) in &self.emission {
            materials[*material].emission.factor = light_at(radiance, time);
        }
        materials.into()
    }

    fn lights_at(&self, time: f64, world: &[DMat4]) -> Result<(Vec<PointLight>, Vec<Sun>), SceneError> {
        let (mut points, mut suns) = (Vec::new(), Vec::new());
        for light in &self.lights {
            match light {
                LightSource::Quad { .. } => {}
                LightSource::Point { position, intensity } => points.push(PointLight {
                    position: (*position - self.shot.origin).as_vec3(),
                    intensity: light_at(intensity, time),
                    cone: None,
                }),
                LightSource::Sun { direction, irradiance, angle_deg } => suns.push(Sun {
                    direction: direction.as_vec3(),
                    irradiance: light_at(irradiance, time),
                    angle_deg: *angle_deg as f32,
                }),
            }
        }
        for light in &self.node_lights {
            let world = &world[light.node];
            if !is_near(world) {
                let name = &self.shot.nodes[light.node].name;
                return Err(SceneError::file(
                    &self.file,
                    format!("the light `{name}` is too far from the origin"),
                ));
            }
            // glTF lights shine along −z. A node of zero scale has no direction; use any.
            let back = world.z_axis.truncate().try_normalize().unwrap_or(DVec3::Z).as_vec3();
            match light.kind {
                NodeLightKind::Point { intensity, cone } => points.push(PointLight {
                    position: world.w_axis.truncate().as_vec3(),
                    intensity,
                    cone: cone.map(|(inner, outer)| (-back, inner, outer)),
                }),
                NodeLightKind::Directional { irradiance } => {
                    suns.push(Sun { direction: back, irradiance, angle_deg: 0.0 });
                }
            }
        }
        Ok((points, suns))
    }

    /// Checks the camera and lights, so that errors appear now and not during a job. Those on nodes are
    /// checked at the first frame only, because each check walks all nodes.
    fn check_views(&self) -> Result<(), SceneError> {
        self.lights_at(self.time(0), &self.still_world)?;
        let frames = if let CameraSource::LookAt(_) = self.camera { self.frames } else { 1 };
        (0..frames).try_for_each(|frame| self.camera(frame).map(|_| ()))
    }
}

/// Returns `true` if a node's origin is within the allowed coordinates. NaN is not.
fn is_near(world: &DMat4) -> bool {
    world.w_axis.abs().max_element() <= LARGEST_COORDINATE && world.is_finite()
}

/// A light's value at a time. Splines may become negative between keys; negative values are clamped to 0.
fn light_at(value: &Animated<DVec3>, time: f64) -> Vec3 {
    value.at(time).max(DVec3::ZERO).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Limits;
    use std::fs;

    /// A triangle on node 0 and a camera on node 1. Node `moving` moves along x from frame 0 to frame 24.
    fn shot(moving: usize) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        let bin: Vec<f32> = vec![0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 1., 0., 0., 3., 2., 0., 3.];
        fs::write(folder.path().join("a.bin"), bin.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
            .unwrap();
        let gltf = format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,1]}}],
            "nodes":[{{"name":"t","mesh":0}},{{"name":"view","camera":0,"translation":[0,0,3]}}],
            "cameras":[{{"type":"perspective","perspective":{{"yfov":1,"znear":0.1,"aspectRatio":1}}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "buffers":[{{"byteLength":68,"uri":"a.bin"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":8}},{{"buffer":0,"byteOffset":44,"byteLength":24}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
                {{"bufferView":1,"componentType":5126,"count":2,"type":"SCALAR","min":[0],"max":[1]}},
                {{"bufferView":2,"componentType":5126,"count":2,"type":"VEC3"}}],
            "animations":[{{"samplers":[{{"input":1,"output":2}}],"channels":[{{"sampler":0,"target":{{"node":{moving},"path":"translation"}}}}]}}]}}"#
        );
        fs::write(folder.path().join("a.gltf"), gltf).unwrap();
        Scene::load(folder.path(), &Limits::default()).unwrap()
    }

    #[test]
    fn a_camera_that_moves_alone_leaves_all_frames_one_geometry() {
        let scene = shot(1);
        let (first, last) = (scene.frame(0).unwrap(), scene.frame(24).unwrap());
        assert_ne!(first.camera.origin, last.camera.origin);
        assert!(!scene.geometry_moves());
        assert!(Arc::ptr_eq(&first.geometry, &last.geometry));
    }

    #[test]
    fn geometry_that_moves_in_some_frame_moves() {
        let scene = shot(0);
        assert!(scene.geometry_moves());
        let (first, last) = (scene.frame(0).unwrap(), scene.frame(24).unwrap());
        assert_ne!(first.geometry.positions, last.geometry.positions);
        assert_eq!(first.camera.origin, last.camera.origin);
    }

    /// A triangle in a shot of ten frames. It is lifted between two frames.
    fn lifted(between: [u32; 2]) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("t.obj"), "o t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
        let [from, to] = between;
        let description = format!(
            r#"{{"version":1,"name":"t","geometry":["t.obj"],
            "camera":{{"origin":[0,0,4],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}},
            "animation":{{"frames":10,"tracks":[{{"target":"object:t","property":"translation","interpolation":"linear",
            "keys":[{{"frame":{from},"value":[0,0,0]}},{{"frame":{to},"value":[0,1,0]}}]}}]}}}}"#
        );
        fs::write(folder.path().join("scene.json"), description).unwrap();
        Scene::load(folder.path(), &Limits::default()).unwrap()
    }

    #[test]
    fn what_moves_late_in_the_shot_moves_and_what_moves_after_its_end_does_not() {
        assert!(lifted([8, 9]).geometry_moves());
        assert!(!lifted([9, 12]).geometry_moves());
    }
}
