//! `bridgesplat-nomesh`: our reconstruction of a variant that was never published. It is the parent class of the
//! released BridgeSplat with the losses of the code that was built on (OET): one free Gaussian at each face centroid,
//! white, isotropic, opacity 0.6, scales frozen; anchors (one per 64 Gaussians, at random) carry a displacement and a
//! quaternion offset, and four of them move each Gaussian; own centres and rotations are learned too. Per frame
//! `5 L1 + 4 rigid + 1 rot + 10 iso + 1 vis` between anchors, `prev` cached once per frame. Left out: OET's depth
//! term, optical-flow start and new points, which need stereo depth. Lengths in released units (100 mm).

use glam::DVec3;

use crate::base::random::{CounterRng, Stage};
use crate::base::{Progress, Result};
use crate::reconstruct::fitting::schedule::{rate_factor, scaled_iterations};
use crate::splat::{DepthOutput, ImageGradient, Rasterizer, Settings, View, Wanted};

use crate::reconstruct::contract::{
    Access, FramePrediction, NovelPrediction, Observation, PoseAccuracy, Reconstruct, Reconstruction,
};
use crate::reconstruct::fitting::anchored::Rates;
use crate::reconstruct::fitting::control_points::ControlField;
use crate::reconstruct::fitting::free::{Free, FreeAdam, FreePatch};
use crate::reconstruct::fitting::loss::pairs::{self, Pairs};
use crate::reconstruct::fitting::loss::photometric::Photometric;
use crate::reconstruct::fitting::optimiser::{Adam, AdamConstants, StepCounter};
use crate::reconstruct::geometry::visible::{Reach, nothing_in_view, visible_points};
use crate::reconstruct::online::{OnlineRun, color_image, held_out, rendered_prediction, shown};
use crate::reconstruct::settings::{BridgesplatNomeshSettings, MethodHeader};

/// BridgeSplat without its mesh.
pub struct BridgesplatNomesh {
    settings: BridgesplatNomeshSettings,
    iteration_scale: f64,
}

impl BridgesplatNomesh {
    /// With `settings`, every iteration count times `iteration_scale`.
    pub fn new(settings: BridgesplatNomeshSettings, iteration_scale: f64) -> Self {
        BridgesplatNomesh { settings, iteration_scale }
    }
}

impl Reconstruct for BridgesplatNomesh {
    fn header(&self) -> &MethodHeader {
        &self.settings.header
    }

    fn access(&self) -> Access {
        Access { expiration_mesh: false, first_depth: false, true_phase: false, poses: PoseAccuracy::True }
    }

    /// The anchors are drawn from the Gaussians.
    fn draws(&self) -> bool {
        true
    }

    fn run(
        &self,
        observation: &Observation,
        emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
        progress: &dyn Progress,
    ) -> Result<Reconstruction> {
        let run = OnlineRun::begin(self.access(), observation)?;
        let mut fit = BridgesplatNomeshFit::new(&self.settings, self.iteration_scale, observation);
        let spent = run.fit_in_order(|frame| fit.fit(frame), emit, progress)?;
        Ok(Reconstruction { final_mesh: None, spent })
    }
}

struct BridgesplatNomeshFit<'a> {
    settings: &'a BridgesplatNomeshSettings,
    scale: f64,
    observation: &'a Observation,
    free: Free,
    anchors: ControlAnchors,
    rasterizer: Rasterizer<f32>,
    adam: FreeAdam,
    reach: Reach,
    image_gradient: Vec<f32>,
}

/// Rest position, displacement and quaternion offset (added to the identity) of the anchors.
struct ControlAnchors {
    ids: Vec<u32>,
    field: ControlField,
    pairs: Pairs,
    rest: Vec<DVec3>,
    displacement: Vec<[f32; 3]>,
    turn: Vec<[f32; 4]>,
    previous: (Vec<DVec3>, Vec<[f64; 4]>),
    adam: [Adam; 2],
}

impl ControlAnchors {
    fn new(settings: &BridgesplatNomeshSettings, centres: &[[f32; 3]], seed: u64) -> Self {
        let points: Vec<DVec3> =
            centres.iter().map(|c| glam::Vec3::from(*c).as_dvec3() / *settings.common.unit_mm).collect();
        let wanted = (points.len() / settings.common.control_subsample.value.max(1) as usize).max(1);
        let mut rng = CounterRng::new(seed, Stage::Method, &[3]);
        let mut ids: Vec<u32> = (0..wanted).map(|_| rng.index(points.len()) as u32).collect();
        ids.sort_unstable();
        ids.dedup();
        let rest: Vec<DVec3> = ids.iter().map(|&i| points[i as usize]).collect();
        let (count, decay) = (*settings.common.control_neighbours as usize, *settings.common.control_decay);
        ControlAnchors {
            field: ControlField::new(&rest, &points, count, decay),
            pairs: Pairs::new(&rest, count, decay),
            displacement: vec![[0.0; 3]; rest.len()],
            turn: vec![[0.0; 4]; rest.len()],
            previous: (rest.clone(), vec![[1.0, 0.0, 0.0, 0.0]; rest.len()]),
            adam: [(); 2].map(|_| Adam::new(AdamConstants::default())),
            rest,
            ids,
        }
    }

    fn positions(&self) -> Vec<DVec3> {
        self.rest.iter().zip(&self.displacement).map(|(r, d)| *r + DVec3::from(d.map(f64::from))).collect()
    }

    fn quaternions(&self) -> Vec<[f64; 4]> {
        self.turn.iter().map(|t| [1.0 + t[0] as f64, t[1] as f64, t[2] as f64, t[3] as f64]).collect()
    }

    /// Adds the gradients of the regularisers to those of colour.
    fn regularise(
        &self,
        settings: &BridgesplatNomeshSettings,
        invisible: &[u32],
        by_shift: &mut [[f32; 3]],
        by_turn: &mut [[f32; 4]],
    ) {
        let s = &settings.common;
        let (positions, quaternions) = (self.positions(), self.quaternions());
        let mut shift = vec![DVec3::ZERO; positions.len()];
        let mut turn = vec![[0.0; 4]; positions.len()];
        self.pairs.rigidity(&self.previous.0, &positions, *s.rigid_weight, &mut shift);
        self.pairs.isometry(&positions, *s.isometry_weight, &mut shift);
        self.pairs.rotation(&self.previous.1, &quaternions, *settings.rotation_weight, &mut turn);
        let moved: Vec<DVec3> = positions.iter().zip(&self.rest).map(|(p, r)| *p - *r).collect();
        pairs::visibility(invisible, &moved, invisible.len() as f64 + 1.0, *s.visibility_weight, &mut shift);
        for ((out, g), (out_turn, g_turn)) in by_shift.iter_mut().zip(&shift).zip(by_turn.iter_mut().zip(&turn)) {
            *out = [0, 1, 2].map(|k| out[k] + g[k] as f32);
            *out_turn = [0, 1, 2, 3].map(|k| out_turn[k] + g_turn[k] as f32);
        }
    }

    fn step(&mut self, rate: f64, by_shift: &[[f32; 3]], by_turn: &[[f32; 4]]) {
        self.adam[0].step(rate, self.displacement.as_flattened_mut(), by_shift.as_flattened());
        self.adam[1].step(rate, self.turn.as_flattened_mut(), by_turn.as_flattened());
    }
}

impl<'a> BridgesplatNomeshFit<'a> {
    fn new(settings: &'a BridgesplatNomeshSettings, scale: f64, observation: &'a Observation) -> Self {
        let free = Free::new(&observation.inspiration, &settings.appearance.gaussians, 1.0, observation.seed);
        BridgesplatNomeshFit {
            settings,
            scale,
            observation,
            anchors: ControlAnchors::new(settings, &free.centres, observation.seed),
            free,
            rasterizer: Rasterizer::new(),
            adam: FreeAdam::new(
                Rates::new(&settings.appearance, rate_factor(scale)),
                StepCounter::Kept,
                AdamConstants::default(),
            ),
            reach: Reach::new(&settings.common.visibility),
            image_gradient: Vec::new(),
        }
    }

    /// The Gaussians that `view` may show where they are now: the released code draws what is in the frustum.
    fn in_view(&self, view: &View) -> FreePatch {
        let mut shift = Vec::new();
        self.anchors.field.apply(&self.anchors.displacement, &mut shift);
        let unit = *self.settings.common.unit_mm as f32;
        let places: Vec<[f32; 3]> =
            self.free.centres.iter().zip(&shift).map(|(c, s)| [0, 1, 2].map(|k| c[k] + s[k] * unit)).collect();
        self.free.patch(visible_points(&[&places], &self.free.sizes_mm(), view, self.reach))
    }

    fn place(&self, patch: &mut FreePatch, field: &ControlField) {
        let (mut shift, mut turn) = (Vec::new(), Vec::new());
        field.apply(&self.anchors.displacement, &mut shift);
        field.apply(&self.anchors.turn, &mut turn);
        let unit = *self.settings.common.unit_mm as f32;
        patch.place(|k| shift[k].map(|v| v * unit), |k| turn[k]);
    }

    fn render(&mut self, patch: &FreePatch, view: &View, depth: DepthOutput) -> Result<()> {
        let settings = Settings { depth, ..Settings::default() };
        self.rasterizer.render(&patch.gaussians, view, &settings, None).map(|_| ())
    }

    fn fit(&mut self, frame: usize) -> Result<FramePrediction> {
        let view = View::new(self.observation.camera, self.observation.world_from_camera[frame]);
        let mut patch = self.in_view(&view);
        if patch.ids.is_empty() && frame == 0 {
            return Err(nothing_in_view());
        }
        let field = self.anchors.field.subset(&patch.ids);
        self.place(&mut patch, &field);
        self.render(&patch, &view, DepthOutput::Skip)?;
        let ahead = held_out(frame).then(|| color_image(&self.rasterizer));
        let invisible = self.invisible_anchors(&patch);
        self.optimise(frame, &view, &mut patch, &field, &invisible)?;
        self.place(&mut patch, &field);
        self.render(&patch, &view, DepthOutput::Surface)?;
        self.free.absorb(&patch);
        let prediction = rendered_prediction(frame, &self.rasterizer, ahead);
        Ok(FramePrediction { novel: self.novel(frame)?, ..prediction })
    }

    /// The view of the frame's second camera, with the Gaussians as they are now.
    fn novel(&mut self, frame: usize) -> Result<Option<NovelPrediction>> {
        let Some(pose) = self.observation.novel_pose[frame] else { return Ok(None) };
        let view = View::new(self.observation.camera, pose);
        let mut patch = self.in_view(&view);
        let field = self.anchors.field.subset(&patch.ids);
        self.place(&mut patch, &field);
        self.render(&patch, &view, DepthOutput::Surface)?;
        Ok(Some(shown(&self.rasterizer)))
    }

    /// Anchors whose own Gaussian is outside the image.
    fn invisible_anchors(&self, patch: &FreePatch) -> Vec<u32> {
        let flags = &self.rasterizer.rendered().visible;
        let visible = |id: u32| patch.ids.binary_search(&id).is_ok_and(|k| flags[k]);
        (0..self.anchors.ids.len() as u32).filter(|&a| !visible(self.anchors.ids[a as usize])).collect()
    }

    fn optimise(
        &mut self,
        frame: usize,
        view: &View,
        patch: &mut FreePatch,
        field: &ControlField,
        invisible: &[u32],
    ) -> Result<()> {
        let s = &self.settings.common;
        let image = self.observation.images[frame].to_unit();
        let weights = self.observation.pixel_weights();
        let mut loss = Photometric::new(&image.data, image.width, image.height, 0.0, weights.as_deref());
        let iterations = scaled_iterations(s.iterations[usize::from(frame > 0)] as f64, self.scale);
        let factor = rate_factor(self.scale);
        let sh_from = if frame > 0 { 0 } else { scaled_iterations(*s.sh_from_iteration as f64, self.scale) };
        let sh_rest = self.adam.rates.sh_rest;
        self.adam.begin(patch.ids.len());
        self.anchors.previous = (self.anchors.positions(), self.anchors.quaternions());
        self.anchors.adam[0].begin(self.anchors.rest.len() * 3, StepCounter::Kept);
        self.anchors.adam[1].begin(self.anchors.rest.len() * 4, StepCounter::Kept);
        let (mut by_shift, mut by_turn) = (Vec::new(), Vec::new());
        let unit = *s.unit_mm as f32;
        for i in 0..iterations {
            self.place(patch, field);
            self.render(patch, view, DepthOutput::Skip)?;
            self.image_gradient.resize(image.data.len(), 0.0);
            loss.evaluate(&self.rasterizer.rendered().color, &mut self.image_gradient);
            self.image_gradient.iter_mut().for_each(|g| *g *= *s.color_weight as f32);
            let gradient = ImageGradient { color: &self.image_gradient, ..ImageGradient::default() };
            let wanted = Wanted::POSITIONS | Wanted::SHAPES | Wanted::SH;
            self.rasterizer.backward(&patch.gaussians, &gradient, wanted)?;
            let gradients = self.rasterizer.gradients();
            let by_points: Vec<[f32; 3]> = gradients.positions.iter().map(|g| g.map(|v| v * unit)).collect();
            field.pull_back(&by_points, &mut by_shift);
            field.pull_back(&gradients.rotations, &mut by_turn);
            self.anchors.regularise(self.settings, invisible, &mut by_shift, &mut by_turn);
            self.adam.rates.sh_rest = if i < sh_from { 0.0 } else { sh_rest };
            patch.step(&mut self.adam, gradients);
            self.anchors.step(*s.displacement_rate * factor, &by_shift, &by_turn);
        }
        self.adam.rates.sh_rest = sh_rest;
        Ok(())
    }
}
