//! Renders and measures a bundle.

use super::args::{Args, base};
use super::ladder::{Rung, cost_at};
use super::measured::{Converged, Gathered, Measured, MeasuredPeer, MeasuredRung, SpeedUp, saved, summary};
use super::opened::Opened;
use super::picture::{Distance, Picture};
use super::quality::Quality;
use super::rendered::Rendered;
use crate::statistics::median;
use anyhow::{Context, Result};
use forelight_denoise::Denoiser;
use forelight_protocol::RenderSettings;
use forelight_renderer_own::RenderError;
use forelight_scene::{Frame, Limits, Scene};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::thread_pool;
use forelight_terminal::output::Bars;
use forelight_tracer::{Settings, Tracer, process_cpu_nanos};
use std::fs;
use std::path::Path;
use std::time::Instant;

/// Seed of the converged image. Its noise must be independent of a rung's.
const OTHER_SEED: u64 = 0x5eed;
/// Range of a difference picture, relative to the image's mean.
const DIFFERENCE_RANGE: f64 = 0.1;

/// A bundle, ready to render at any quality.
pub struct Bench<'a> {
    args: &'a Args,
    bars: &'a Bars,
    interrupt: &'a Interrupt,
    name: String,
    frame: Frame,
    base: RenderSettings,
    /// Owns the tree that all renders share.
    tracer: Tracer,
    pool: rayon::ThreadPool,
    /// For rungs with allotted camera samples, and denoised ones.
    opened: Option<Opened>,
    denoiser: Option<Denoiser>,
}

impl<'a> Bench<'a> {
    pub fn open(
        args: &'a Args,
        bundle: &Path,
        rungs: &[Quality],
        bars: &'a Bars,
        interrupt: &'a Interrupt,
    ) -> Result<Self> {
        if !bundle.exists() {
            let missing = format!("bundle {}: this file or folder does not exist", bundle.display());
            return Err(BadInput::new(missing).into());
        }
        let spinner = bars.spinner(format!("loading {}", bundle.display()));
        let base = base(args);
        let frame = |scene: &Scene| scene.frame_with(args.frame, Some((base.width, base.height)));
        let loaded = Scene::load(bundle, &Limits::default()).and_then(|scene| {
            let frame = frame(&scene)?;
            Ok((scene.name().to_owned(), frame))
        });
        let (name, frame) =
            loaded.map_err(RenderError::from).with_context(|| format!("bundle {}", bundle.display()))?;
        let pool = thread_pool(args.threads)?;
        let tracer = pool.install(|| Tracer::new(&frame, &Settings::from(&base)));
        let open = || pool.install(|| Opened::open(bundle, args.frame, &base));
        let is_special = |rung: &Quality| rung.error().is_some() || rung.is_denoised();
        let opened = rungs.iter().any(is_special).then(open).transpose()?;
        let denoiser = rungs.iter().any(Quality::is_denoised).then(Denoiser::find).transpose()?;
        spinner.finish_and_clear();
        Ok(Self { args, bars, interrupt, name, frame, base, tracer, pool, opened, denoiser })
    }

    pub fn measure(&self, rungs: &[Quality]) -> Result<Measured> {
        let settings: Vec<Settings> =
            rungs.iter().map(|rung| rung.settings(&self.base)).collect::<Result<_, _>>()?;
        let converged = self.reference(&self.args.reference, OTHER_SEED)?;
        let compared = |rung: &Quality| rung.samples_like(self.args.gather_spp);
        let wanted = self.args.gather_rays > 0 && rungs.iter().any(compared);
        let gathered = wanted.then(|| self.gathered()).transpose()?;
        let mut measured = self.rungs(rungs, &settings)?;
        let mut found = Vec::with_capacity(rungs.len());
        for (rung, renders) in rungs.iter().zip(&mut measured) {
            let against = gathered.as_ref().filter(|_| compared(rung)).map(|g| &g.0);
            found.push(summary(rung, renders, &converged, against)?);
        }
        if let Some(folder) = &self.args.pictures {
            let images = rungs.iter().zip(&measured).map(|(rung, renders)| (rung, &renders[0].picture));
            self.draw(folder, images, &converged, gathered.as_ref().map(|g| &g.0))?;
        }
        Ok(Measured {
            bundle: self.name.clone(),
            size: self.args.size,
            ambient_bounces: self.args.ambient_bounces,
            threads: self.pool.current_num_threads(),
            repeats: self.args.repeats,
            cached: saved(&found),
            second_thread: self.second_thread(rungs, &settings)?,
            peers: self.peers(&found, &converged)?,
            reference: Converged {
                flags: self.args.reference.to_string(),
                mean: converged.mean(),
                gathered: gathered.map(|g| g.1),
            },
            rungs: found,
        })
    }

    /// Renders all rungs in turns, so that other load on the machine affects all of them.
    fn rungs(&self, rungs: &[Quality], settings: &[Settings]) -> Result<Vec<Vec<Rendered>>> {
        let bar = self.bars.bar("rendering", rungs.len() as u64 * u64::from(self.args.repeats));
        let mut renders: Vec<Vec<Rendered>> = rungs.iter().map(|_| Vec::new()).collect();
        for _ in 0..self.args.repeats {
            for ((rung, settings), renders) in rungs.iter().zip(settings).zip(&mut renders) {
                bar.set_message(rung.to_string());
                let asked = rung.asked(&self.base)?;
                renders.push(match (&self.opened, rung.error(), &self.denoiser) {
                    (Some(opened), Some(error), _) => {
                        self.pool.install(|| opened.render(&asked, error, self.interrupt))?
                    }
                    (Some(opened), None, Some(denoiser)) if rung.is_denoised() => {
                        self.pool.install(|| opened.denoised(&asked, denoiser, self.interrupt))?
                    }
                    _ => self.render(settings, &self.pool)?,
                });
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(renders)
    }

    fn render(&self, settings: &Settings, pool: &rayon::ThreadPool) -> Result<Rendered> {
        let (start, used) = (Instant::now(), process_cpu_nanos());
        let (image, cache) = pool.install(|| {
            let tracer = Tracer::with_bvh(&self.frame, settings, self.tracer.bvh().clone());
            let image = tracer.render(None, &|_| (), self.interrupt.flag());
            (image, tracer.cache().map(|cache| cache.totals()).unwrap_or_default())
        });
        let cpu_nanos = process_cpu_nanos() - used;
        let wall_seconds = start.elapsed().as_secs_f64();
        let image = image.ok_or(Interrupted)?;
        Ok(Rendered {
            work: image.totals().work + cache.plan.work + cache.fill.work,
            plan: cache.plan.work,
            fill: cache.fill.work,
            records: cache.records,
            cpu_seconds: cpu_nanos as f64 * 1e-9,
            wall_seconds,
            picture: Picture::of(&image),
        })
    }

    /// A converged image, from its folder or rendered and stored there.
    fn reference(&self, quality: &Quality, seed: u64) -> Result<Picture> {
        let settings = Settings { seed: self.base.seed ^ seed, ..quality.settings(&self.base)? };
        let kept = self.args.references.as_ref().map(|folder| {
            let tracer = Tracer::with_bvh(&self.frame, &settings, self.tracer.bvh().clone());
            let fingerprint = tracer.fingerprint();
            let name: String = fingerprint[..8].iter().map(|byte| format!("{byte:02x}")).collect();
            folder.join(format!("{}-{name}.exr", self.name))
        });
        if let Some(path) = kept.as_ref().filter(|path| path.exists()) {
            return Picture::read(path);
        }
        let spinner = self.bars.spinner(format!("converged image: {quality}"));
        let picture = self.render(&settings, &self.pool)?.picture;
        spinner.finish_and_clear();
        if let Some(path) = &kept {
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
            }
            picture.write(path)?;
        }
        Ok(picture)
    }

    /// The samples of a rung with gathers of very many rays, and an upper estimate of the remaining noise. A
    /// quarter of the rays has at least twice the noise, because rays are stratified. So the difference of
    /// the two is at least √3 times the noise, even if they share rays.
    fn gathered(&self) -> Result<(Picture, Gathered)> {
        let (spp, rays) = (self.args.gather_spp, self.args.gather_rays);
        let quality = Quality::gathered(spp, rays).map_err(BadInput::new)?;
        let fewer = Quality::gathered(spp, rays.div_ceil(4)).map_err(BadInput::new)?;
        let (best, good) = (self.reference(&quality, 0)?, self.reference(&fewer, 0)?);
        let noise = good.distance(&best)?.rmse / 3.0f64.sqrt();
        Ok((best, Gathered { flags: quality.to_string(), noise }))
    }

    /// Measures the last cached and the last uncached rung of the compared samples on one and two threads, in
    /// turns.
    fn second_thread(&self, rungs: &[Quality], settings: &[Settings]) -> Result<Vec<SpeedUp>> {
        let (one, two) = (thread_pool(Some(1))?, thread_pool(Some(2))?);
        let mut speed_ups = Vec::new();
        for cached in [false, true] {
            let wanted =
                |rung: &Quality| rung.is_cached() == cached && rung.samples_like(self.args.gather_spp);
            let Some(i) = rungs.iter().rposition(wanted) else { continue };
            let mut ratios = Vec::new();
            for _ in 0..self.args.repeats {
                let alone = self.render(&settings[i], &one)?.wall_seconds;
                ratios.push(alone / self.render(&settings[i], &two)?.wall_seconds);
            }
            ratios.sort_by(f64::total_cmp);
            let [lowest, highest] = [ratios[0], ratios[ratios.len() - 1]];
            speed_ups.push(SpeedUp { flags: rungs[i].to_string(), ratio: median(&ratios), lowest, highest });
        }
        Ok(speed_ups)
    }

    fn peers(&self, rungs: &[MeasuredRung], converged: &Picture) -> Result<Vec<MeasuredPeer>> {
        let read =
            |path: &Path| Picture::read(path).map_err(|error| BadInput::new(format!("--peer: {error:#}")));
        let mut peers = Vec::with_capacity(self.args.peer.len());
        for peer in &self.args.peer {
            let image = read(&peer.image)?;
            let own = peer.reference.as_deref().map(read).transpose()?;
            let error = image.distance(own.as_ref().unwrap_or(converged))?;
            let cost = |error_of: fn(&Distance) -> f64| {
                let ours = rungs.iter().map(|r| Rung { error: error_of(&r.error), cost: r.cpu_seconds });
                cost_at(ours, error_of(&error))
            };
            let (all, lit) = (cost(|d| d.rmse), cost(|d| d.lit));
            peers.push(MeasuredPeer {
                name: peer.name.clone(),
                cpu_seconds: peer.cpu_seconds,
                error,
                reference: own.map(|own| own.distance(converged)).transpose()?,
                ratio: all.ratio(peer.cpu_seconds),
                ratio_lit: lit.ratio(peer.cpu_seconds),
                bound: all.is_bound() || lit.is_bound(),
            });
        }
        Ok(peers)
    }

    /// Writes the images and their differences due to the cache.
    fn draw<'p>(
        &self,
        folder: &Path,
        images: impl Iterator<Item = (&'p Quality, &'p Picture)>,
        converged: &Picture,
        gathered: Option<&Picture>,
    ) -> Result<()> {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        converged.write(&folder.join(format!("{}-converged.exr", self.name)))?;
        for (rung, image) in images {
            let flags: String = rung.to_string().replace("--", "").replace(' ', "-");
            let path = folder.join(format!("{}-{flags}", self.name));
            image.write(&path.with_added_extension("exr"))?;
            let against = match gathered {
                Some(gathered) if rung.samples_like(self.args.gather_spp) => gathered,
                _ => converged,
            };
            let difference = path.with_added_extension("difference.png");
            let written = image.difference(against, DIFFERENCE_RANGE).save(&difference);
            written.with_context(|| format!("cannot write {}", difference.display()))?;
        }
        Ok(())
    }
}
