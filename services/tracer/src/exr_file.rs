//! Writes OpenEXR files on all threads that this process may use, with the bytes of one thread. The writer of
//! `exr` would start a thread for each core of the machine.

use exr::block::{self, BlockIndex, UncompressedBlock, writer::ChunksWriter};
use exr::error::{Result, UnitResult};
use exr::image::write::layers::{LayersWriter, WritableLayers};
use exr::image::{AnyChannels, FlatSamples, Image, Layer};
use exr::io::attempt_delete_file_on_write_error;
use std::io::BufWriter;
use std::path::Path;

/// Writes the image. If that fails, no file is left.
pub(crate) fn write(image: &Image<Layer<AnyChannels<FlatSamples>>>, path: &Path) -> UnitResult {
    let headers = image.layer_data.infer_headers(&image.attributes);
    let layers = image.layer_data.create_writer(&headers);
    attempt_delete_file_on_write_error(path, |file| {
        block::write(BufWriter::new(file), headers, true, |meta, writer| {
            let blocks: Vec<(usize, BlockIndex)> =
                block::enumerate_ordered_header_block_indices(&meta.headers).collect();
            let compressed = forelight_threads::map(&blocks, 1, |&(number, index)| {
                let data = layers.extract_uncompressed_block(&meta.headers, index);
                Ok((number, UncompressedBlock { index, data }.compress_to_chunk(&meta.headers)?))
            });
            compressed.into_iter().try_for_each(|block: Result<_>| {
                let (number, chunk) = block?;
                writer.write_chunk(number, chunk)
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{AnyChannel, Encoding, LayerAttributes, WritableImage};

    #[test]
    fn a_file_has_the_bytes_of_the_library_on_any_number_of_threads() {
        let folder = tempfile::tempdir().unwrap();
        let (width, height) = (61, 83);
        let values = (0..width * height).map(|i| (i as f32 * 0.37).sin() * (i % 13) as f32);
        let ids = (0..width * height).map(|i| (i / 97) as u32);
        let channels = [
            AnyChannel::new("R", FlatSamples::F32(values.collect())),
            AnyChannel::new("object.id", FlatSamples::U32(ids.collect())),
        ];
        let image = Image::from_layer(Layer::new(
            (width, height),
            LayerAttributes::default(),
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(channels.into_iter().collect()),
        ));
        let theirs = folder.path().join("theirs.exr");
        image.write().non_parallel().to_file(&theirs).unwrap();
        for threads in [1, 2, 5] {
            let ours = folder.path().join("ours.exr");
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| write(&image, &ours)).unwrap();
            assert!(std::fs::read(&ours).unwrap() == std::fs::read(&theirs).unwrap(), "{threads} threads");
        }
        assert!(write(&image, &folder.path().join("none/x.exr")).is_err());
    }
}
