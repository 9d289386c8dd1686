//! Opens a glTF file: checks its JSON and reads its buffers through the bundle. The importer of the `gltf`
//! crate reads any path and panics on some malformed files.

use super::channels::without_nodeless;
use super::extensions::Extensions;
use crate::bundle::{Bundle, resolve};
use crate::description::json_pointer;
use crate::error::{Place, SceneError};
use gltf::Document;
use gltf::json::validation::{Checked, Error, Validate};
use gltf::json::{Path, Root};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// Extensions that a file may require.
pub(super) const UNDERSTOOD: [&str; 13] = [
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_transform",
];

/// An open glTF file.
pub(super) struct Opened {
    /// Path in the bundle.
    pub(super) file: String,
    pub(super) document: Document,
    /// Contents of every buffer, each at least as long as the document says. Empty for a placeholder.
    buffers: Vec<Rc<Vec<u8>>>,
    /// Whether animation channels that move no node were left out.
    pub(super) nodeless_channels: bool,
    /// What the document's compressed parts are.
    pub(super) extensions: Extensions,
    /// Contents of compressed buffer views.
    decoded: BTreeMap<usize, Vec<u8>>,
}

impl Opened {
    pub(super) fn fail<T>(&self, pointer: &str, reason: impl Into<String>) -> Result<T, SceneError> {
        Err(SceneError::pointer(&self.file, pointer, reason))
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: usize) -> Result<&[u8], SceneError> {
        if let Some(bytes) = self.decoded.get(&index) {
            return Ok(bytes);
        }
        let pointer = format!("/bufferViews/{index}");
        let Some(view) = self.document.views().nth(index) else {
            return self.fail(&pointer, "there is no such buffer view");
        };
        match slice(&self.buffers, view.buffer().index(), view.offset(), view.length()) {
            Some(bytes) => Ok(bytes),
            None => self.fail(&pointer, "reaches beyond the end of its buffer"),
        }
    }

    /// Decodes all compressed buffer views. The bundle's limit on bytes covers what they decode to.
    fn decode_views(&mut self, bundle: &Bundle) -> Result<(), SceneError> {
        for (&index, view) in &self.extensions.views {
            let pointer = format!("/bufferViews/{index}/extensions");
            let length = self.document.views().nth(index).map(|view| view.length());
            if view.decoded_length().is_none() || view.decoded_length() != length {
                return self.fail(&pointer, "`count` × `byteStride` is not the length of the buffer view");
            }
            let Some(stream) = slice(&self.buffers, view.buffer, view.byte_offset, view.byte_length) else {
                return self.fail(&pointer, "the compressed stream reaches beyond the end of its buffer");
            };
            bundle.count_expanded(&self.file, length.unwrap_or(0) as u64)?;
            match view.decode(stream) {
                Ok(bytes) => self.decoded.insert(index, bytes),
                Err(reason) => return self.fail(&pointer, reason),
            };
        }
        Ok(())
    }
}

/// A part of a buffer. `None` if it reaches beyond its end.
fn slice(buffers: &[Rc<Vec<u8>>], buffer: usize, offset: usize, length: usize) -> Option<&[u8]> {
    buffers.get(buffer)?.get(offset..offset.checked_add(length)?)
}

/// Reads and checks a `.gltf` or `.glb` file and its buffers.
pub(super) fn open(bundle: &Bundle, file: &str) -> Result<Opened, SceneError> {
    let bytes = bundle.read(file)?;
    let (json, binary) = if bytes.starts_with(b"glTF") {
        split_binary(&bytes).map_err(|reason| SceneError::file(file, reason))?
    } else {
        (bytes.as_slice(), None)
    };
    let json = json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(json);
    let rest = without_nodeless(json);
    let nodeless_channels = rest.is_some();
    let json = rest.as_deref().unwrap_or(json);
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let mut root: Root = serde_path_to_error::deserialize(&mut deserializer)
        .map_err(|e| SceneError::pointer(file, json_pointer(e.path()), e.inner().to_string()))?;
    let malformed = |(pointer, reason): (String, String)| SceneError::pointer(file, pointer, reason);
    check(&root).map_err(malformed)?;
    let extensions = Extensions::read(&root, json).map_err(malformed)?;
    extensions.use_webp(&mut root);
    // The crate rejects some extensions that this module supports, and `check` has checked them all.
    root.extensions_required.clear();
    let without_view = extensions.accessors_without_view(&root);
    let allowed: BTreeSet<String> =
        without_view.into_iter().map(|accessor| format!("/accessors/{accessor}/bufferView")).collect();
    let mut first = None;
    root.validate(&root, Path::new, &mut |path, error| {
        let pointer = as_pointer(&path());
        if !(matches!(error, Error::Missing) && allowed.contains(&pointer)) {
            first.get_or_insert((pointer, error.to_string()));
        }
    });
    if let Some(error) = first {
        return Err(malformed(error));
    }
    let buffers = buffers(bundle, file, &root, &extensions, binary)?;
    let document = Document::from_json_without_validation(root);
    let mut opened = Opened {
        file: file.to_owned(),
        document,
        buffers,
        nodeless_channels,
        extensions,
        decoded: BTreeMap::new(),
    };
    opened.decode_views(bundle)?;
    Ok(opened)
}

/// Reads the contents of all buffers. A file that several of them name is read once.
fn buffers(
    bundle: &Bundle,
    file: &str,
    root: &Root,
    extensions: &Extensions,
    mut binary: Option<&[u8]>,
) -> Result<Vec<Rc<Vec<u8>>>, SceneError> {
    let mut buffers = Vec::new();
    let mut by_uri: BTreeMap<&str, Rc<Vec<u8>>> = BTreeMap::new();
    for (i, buffer) in root.buffers.iter().enumerate() {
        let pointer = format!("/buffers/{i}");
        // A placeholder may also have contents, for programs that do not know its extension.
        if extensions.placeholders.contains(&i) && (buffer.uri.is_some() || i > 0 || binary.is_none()) {
            buffers.push(Rc::default());
            continue;
        }
        let data = match (&buffer.uri, binary.take()) {
            (Some(uri), unused) => {
                binary = unused;
                match by_uri.get(uri.as_str()) {
                    Some(known) => known.clone(),
                    None => {
                        let read = Rc::new(resource(bundle, file, uri, &pointer)?);
                        by_uri.insert(uri, read.clone());
                        read
                    }
                }
            }
            (None, Some(chunk)) if i == 0 => Rc::new(chunk.to_vec()),
            (None, _) => {
                return Err(SceneError::pointer(file, pointer, "has neither a `uri` nor a binary chunk"));
            }
        };
        if (data.len() as u64) < buffer.byte_length.0 {
            let reason = format!("is {} bytes long, not {}", data.len(), buffer.byte_length.0);
            return Err(SceneError::pointer(file, pointer, reason));
        }
        buffers.push(data);
    }
    Ok(buffers)
}

/// The bytes of a `uri`: a file of the bundle, or a base64 data URI.
pub(super) fn resource(bundle: &Bundle, file: &str, uri: &str, pointer: &str) -> Result<Vec<u8>, SceneError> {
    let fail = |reason: String| SceneError::pointer(file, pointer, reason);
    if uri.starts_with("data:") {
        let data = gltf::buffer::Data::from_source(gltf::buffer::Source::Uri(uri), None);
        return data.map(|data| data.0).map_err(|e| fail(format!("the data URI is damaged: {e}")));
    }
    let path = resource_path(file, uri).map_err(fail)?;
    bundle.read(&path).map_err(|e| e.within(file, Place::Pointer(pointer.to_owned()), "`uri`"))
}

/// The path in the bundle of a `uri` that is not a data URI.
pub(super) fn resource_path(file: &str, uri: &str) -> Result<String, String> {
    resolve(file, &percent_decoded(uri).ok_or_else(|| format!("`{uri}` is not a valid URI"))?)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        let byte = match byte {
            b'%' => {
                let digit = |b: Option<u8>| b.and_then(|b| char::from(b).to_digit(16));
                (digit(rest.next())? * 16 + digit(rest.next())?) as u8
            }
            plain => plain,
        };
        bytes.push(byte);
    }
    String::from_utf8(bytes).ok()
}

/// Splits a `.glb` file into its JSON and binary chunk. The header must match the file's length.
fn split_binary(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let word = |at: usize| {
        let bytes = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err("the header of the binary glTF is truncated".into());
    };
    if version != 2 {
        return Err(format!("binary glTF version {version} is not supported; this program reads version 2"));
    }
    if length as usize > bytes.len() {
        return Err(format!(
            "the file is truncated: its header says {length} bytes, but it has {}",
            bytes.len()
        ));
    }
    let chunk = |at: usize, kind: &[u8; 4]| -> Result<Option<(&[u8], usize)>, String> {
        let Some(size) = word(at).filter(|_| bytes.get(at + 4..at + 8) == Some(kind)) else {
            return Ok(None);
        };
        let end = (at + 8).saturating_add(size as usize);
        match bytes.get(at + 8..end) {
            Some(data) if end <= length as usize => Ok(Some((data, end))),
            _ => Err("a chunk of the binary glTF reaches beyond its end".into()),
        }
    };
    let (json, end) = chunk(12, b"JSON")?.ok_or("the binary glTF does not begin with a JSON chunk")?;
    Ok((json, chunk(end, b"BIN\0")?.map(|(data, _)| data)))
}

/// Finds errors that the crate's validation misses or panics on. Returns a JSON pointer and a reason.
fn check(root: &Root) -> Result<(), (String, String)> {
    let fail = |pointer: String, reason: &str| Err((pointer, reason.to_owned()));
    check_version(root)?;
    for (i, extension) in root.extensions_required.iter().enumerate() {
        if !UNDERSTOOD.contains(&extension.as_str()) {
            let reason = format!("`{extension}` is required but not supported");
            return Err((format!("/extensionsRequired/{i}"), reason));
        }
    }
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            for (semantic, accessor) in &primitive.attributes {
                if accessor.value() >= root.accessors.len() {
                    let name = match semantic {
                        Checked::Valid(semantic) => semantic.to_string(),
                        Checked::Invalid => "?".into(),
                    };
                    let pointer = format!("/meshes/{m}/primitives/{p}/attributes/{name}");
                    return fail(pointer, "there is no such accessor");
                }
            }
        }
    }
    for (a, animation) in root.animations.iter().enumerate() {
        for (c, channel) in animation.channels.iter().enumerate() {
            if channel.target.node.value() >= root.nodes.len() {
                let pointer = format!("/animations/{a}/channels/{c}/target/node");
                return fail(pointer, "there is no such node");
            }
            if matches!(channel.target.path, Checked::Invalid) {
                let pointer = format!("/animations/{a}/channels/{c}/target/path");
                return fail(pointer, "is not one of `translation`, `rotation`, `scale`, `weights`");
            }
        }
    }
    for (i, image) in root.images.iter().enumerate() {
        if image.uri.is_none() && image.buffer_view.is_none() {
            return fail(format!("/images/{i}"), "has neither a `uri` nor a `bufferView`");
        }
    }
    Ok(())
}

/// Checks the versions by section 3.2 of the glTF 2.0 specification. Files of any version 2 can be read,
/// unless they say that a reader must know a newer one than 2.0.
fn check_version(root: &Root) -> Result<(), (String, String)> {
    let parsed = |version: &str| -> Option<(u32, u32)> {
        let (major, minor) = version.split_once('.')?;
        Some((major.parse().ok()?, minor.parse().ok()?))
    };
    if let Some(least) = &root.asset.min_version
        && parsed(least) != Some((2, 0))
    {
        let reason = format!("needs a reader of glTF version {least}; this program reads version 2.0");
        return Err(("/asset/minVersion".into(), reason));
    }
    let version = &root.asset.version;
    if parsed(version).is_none_or(|(major, _)| major != 2) {
        let reason = format!("glTF version {version} is not supported; this program reads version 2.0");
        return Err(("/asset/version".into(), reason));
    }
    Ok(())
}

/// Converts the crate's path notation, such as `meshes[0].name`, to a JSON pointer.
fn as_pointer(path: &Path) -> String {
    let mut pointer = String::from("/");
    for c in path.as_str().chars() {
        match c {
            '.' | '[' => pointer.push('/'),
            ']' | '"' => {}
            other => pointer.push(other),
        }
    }
    pointer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_escapes_are_decoded_and_damaged_ones_refused() {
        assert_eq!(percent_decoded("a%20b%C3%A9").as_deref(), Some("a bé"));
        assert_eq!(percent_decoded("a%2"), None);
        assert_eq!(percent_decoded("%zz"), None);
        assert_eq!(percent_decoded("%ff"), None);
        assert_eq!(resource_path("m/a.gltf", "%2e%2e/x.bin").as_deref(), Ok("x.bin"));
        assert!(resource_path("a.gltf", "%2e%2e/x.bin").is_err());
    }

    #[test]
    fn places_become_json_pointers() {
        let path = Path::new().field("meshes").index(3).field("attributes").key("POSITION");
        assert_eq!(as_pointer(&path), "/meshes/3/attributes/POSITION");
    }
}
