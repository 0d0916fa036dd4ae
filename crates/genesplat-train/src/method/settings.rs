//! The settings of all methods, in one plain struct; each method has some of them, with defaults of its own.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::MethodName;

/// Declares [`MethodConfig`], and its twin of which a file may name any part.
macro_rules! settings {
    ($($(#[doc = $doc:literal])+ $field:ident: $type:ty,)+) => {
        /// Settings of a method. Those that are none of its own have no effect, and stand in no file.
        #[derive(Clone, Debug, PartialEq)]
        pub struct MethodConfig {
            /// Which method.
            pub name: MethodName,
            $($(#[doc = $doc])+ pub $field: $type,)+
        }

        /// What a file names.
        #[derive(Default, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        struct Named {
            #[serde(skip_serializing_if = "Option::is_none")]
            name: Option<MethodName>,
            $(#[serde(skip_serializing_if = "Option::is_none")] $field: Option<$type>,)+
        }

        impl Named {
            /// The names of what is there.
            fn names(&self) -> Vec<&'static str> {
                [$(self.$field.is_some().then_some(stringify!($field))),+].into_iter().flatten().collect()
            }

            fn over(self, defaults: MethodConfig) -> MethodConfig {
                MethodConfig { name: defaults.name, $($field: self.$field.unwrap_or(defaults.$field)),+ }
            }

            /// The settings that mean something to the method.
            fn own(config: &MethodConfig) -> Self {
                let own = config.name.method().own_settings();
                let has = |name| own.contains(&name);
                Self { name: Some(config.name), $($field: has(stringify!($field)).then_some(config.$field)),+ }
            }
        }
    };
}

settings! {
    /// Rate of positions at the start, in scene extents; above 0.
    position_rate_start: f64,
    /// Rate of positions at the end, in scene extents; above 0. It decays exponentially over 30,000
    /// iterations, with `genesplat` over the run.
    position_rate_end: f64,
    /// Rate of the base colour; that of the view-dependent colour is a twentieth of it. Not negative.
    feature_rate: f64,
    /// Rate of the opacity logits; not negative.
    opacity_rate: f32,
    /// Rate of the log-scales; not negative.
    scale_rate: f32,
    /// Rate of the quaternions; not negative.
    rotation_rate: f32,
    /// Densification and opacity resets end before this iteration; 0 switches both off.
    densify_until: u32,
    /// Iterations between two densifications; at least 1.
    densify_every: u32,
    /// Mean screen-space gradient from which a Gaussian grows, in normalised device coordinates; above 0.
    /// Lower grows more Gaussians.
    gradient_threshold: f32,
    /// Larger Gaussians are pruned after 3,000 iterations or the first reset, in scene extents; above 0. (In
    /// forward-facing scenes walls and floors are larger than the published size, and are lost; 10 keeps
    /// them.)
    prune_size: f64,
    /// Iterations between two opacity resets; at least 1.
    reset_every: u32,
    /// Fraction of Gaussians added each time, until the limit is reached; not negative.
    growth: f64,
    /// Exploration noise, in multiples of the position rate; not negative. It is in the scene's own units, as
    /// in the authors' code, but for extents below 1 or above 10.
    noise: f32,
    /// Weight of the mean opacity in the loss; not negative. Higher leaves more Gaussians to relocate.
    opacity_weight: f32,
    /// Weight of the mean scale in the loss, in the same units; not negative. Higher makes Gaussians smaller.
    scale_weight: f32,
    /// Factor on the number of Gaussians that the photos can determine, which the cloud may grow to; 0 for no
    /// such limit. That number is the least of their pixels over 2 · √photos, 70 times the root of their
    /// pixels, and the pixels of one photo over 0.3. A lower `max_gaussians` counts.
    capacity: f64,
    /// The cloud approaches its limit by the power 1.5 of the iterations of density control, and not along
    /// Improved-GS's root; runs of less than 5,000 iterations follow the root.
    gradual_growth: bool,
    /// Where a run from points looks at each photo fewer times than this, it grows along that root, resets no
    /// opacities (unless a search follows), averages the last fifth alone, starts with 4 times the rate of
    /// positions, and doubles the rates of colours, opacities and scales. 0 for never.
    few_looks: u32,
    /// The mean of the states of the last two fifths of the run is the result.
    averaging: bool,
    /// A run that looks at each photo so often also trains on virtual views: every second step of its last 70
    /// % with at most 16 photos, and fewer with more. 0 for never.
    virtual_views: u32,
}

impl MethodConfig {
    /// The settings of a method that nobody has changed.
    pub fn of(name: MethodName) -> Self {
        name.method().defaults()
    }
}

impl Default for MethodConfig {
    fn default() -> Self {
        Self::of(MethodName::default())
    }
}

impl Serialize for MethodConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Named::own(self).serialize(serializer)
    }
}

/// A name alone stands for the method as published.
#[derive(Deserialize)]
#[serde(untagged)]
enum NameOrTable {
    Name(String),
    Table(toml::Table),
}

impl<'de> Deserialize<'de> for MethodConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let named = match NameOrTable::deserialize(deserializer)? {
            NameOrTable::Name(name) => return by_name(&name).map(Self::of).map_err(Error::custom),
            NameOrTable::Table(table) => {
                table.try_into::<Named>().map_err(|error| Error::custom(error.message()))?
            }
        };
        let name = named.name.unwrap_or_default();
        let own = name.method().own_settings();
        match named.names().into_iter().find(|setting| !own.contains(setting)) {
            Some(setting) => Err(Error::custom(not_its_own(name, setting))),
            None => Ok(named.over(Self::of(name))),
        }
    }
}

fn by_name(name: &str) -> Result<MethodName, String> {
    let all = MethodName::ALL.map(MethodName::name).join(", ");
    MethodName::from_name(name).ok_or_else(|| format!("there is no method `{name}`; the methods are {all}"))
}

fn not_its_own(name: MethodName, setting: &str) -> String {
    let has = |other: &MethodName| other.method().own_settings().contains(&setting);
    let others: Vec<&str> = MethodName::ALL.into_iter().filter(has).map(MethodName::name).collect();
    format!("`{setting}` is no setting of {name}; it is one of {}", others.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<MethodConfig, String> {
        toml::from_str::<MethodConfig>(text).map_err(|error| error.message().to_owned())
    }

    #[test]
    fn every_method_survives_its_file_which_names_its_own_settings_alone() {
        for name in MethodName::ALL {
            let config = MethodConfig::of(name);
            assert_eq!(config.name, name);
            let text = toml::to_string(&config).unwrap();
            assert_eq!(read(&text).unwrap(), config);
            let own = name.method().own_settings();
            assert_eq!(text.lines().count(), 1 + own.len(), "{text}");
            assert!(own.len() <= 14, "{name}: {} settings", own.len());
        }
    }

    #[test]
    fn a_part_is_enough_and_what_is_no_setting_of_the_method_is_told() {
        let config = read("name = \"mcmc\"\nnoise = 7.0").unwrap();
        assert_eq!(config, MethodConfig { noise: 7.0, ..MethodConfig::of(MethodName::Mcmc) });
        assert_eq!(read("").unwrap(), MethodConfig::default());
        assert_eq!(read("noise = 1.0").unwrap_err(), "`noise` is no setting of genesplat; it is one of mcmc");
        assert!(read("nois = 1.0").unwrap_err().contains("`nois`"));
        assert!(read("name = \"2dgs\"").unwrap_err().contains("`2dgs`"));
    }

    #[test]
    fn a_name_alone_is_the_method_as_published() {
        #[derive(Deserialize)]
        struct File {
            method: MethodConfig,
        }
        let file = |text: &str| toml::from_str::<File>(text).map(|file| file.method);
        assert_eq!(file("method = \"3dgs\"").unwrap(), MethodConfig::of(MethodName::ThreeDgs));
        assert!(file("method = \"magic\"").unwrap_err().to_string().contains("there is no method `magic`"));
    }
}
